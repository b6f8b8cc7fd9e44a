"""One module per file format, reading and writing; every file appears whole."""
