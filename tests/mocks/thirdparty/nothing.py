"""A module without a mock."""
