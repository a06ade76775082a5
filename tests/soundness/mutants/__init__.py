"""Tests of the catalogue's defects, which are in ``reference_adapters/defects``."""
