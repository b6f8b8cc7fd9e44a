"""One term of a fitting energy per file."""
