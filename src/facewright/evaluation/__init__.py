"""Measured suites: every figure the project quotes is made here."""
