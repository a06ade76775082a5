"""Honest adapters: the reference adapters, each with one other choice that is legal. None of them may be accused of anything."""
