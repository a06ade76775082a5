"""Definitions that every room uses: errors, findings, statuses, the envelope, the error registry, statistics. Pure."""
