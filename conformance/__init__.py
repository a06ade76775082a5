"""The conformance suite: the benchmark's tasks, one module for each protocol and one for tasks on several protocols."""
