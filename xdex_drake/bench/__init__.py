"""Stopwatches: how long each stage takes."""
