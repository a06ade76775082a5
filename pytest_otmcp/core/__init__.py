"""Definitions that all parts of the kit use: errors, findings, statuses, the error registry, statistics. Pure."""
