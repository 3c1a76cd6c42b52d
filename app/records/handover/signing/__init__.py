"""Signing a sheet: who leaves, who comes."""
