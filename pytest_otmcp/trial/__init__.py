"""Runs one item: adapter, device and steps come together, and replies and journals are judged."""
