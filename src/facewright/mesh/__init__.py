"""Topology, differential operators, geodesics, subdivision."""
