"""Formats of other tools: hands and scenes as files that those tools open."""
