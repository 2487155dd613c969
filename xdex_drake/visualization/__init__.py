"""Meshcat pages and recordings, pictures and reports."""
