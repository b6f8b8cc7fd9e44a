"""The database of people: one Zarr store, the jobs that fill it, imports from and exports to other databases."""
