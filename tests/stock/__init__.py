"""Adapters made with stock parts, in Python and in TypeScript."""
