"""The command line: one module per verb; parse, call one app function, print."""
