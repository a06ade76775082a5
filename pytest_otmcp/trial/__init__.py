"""Execution of one item: a task's steps run with its adapters and devices; their replies and journals are judged."""
