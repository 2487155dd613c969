"""Problem files: what they say, and how they are solved."""
