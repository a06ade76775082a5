"""What is required: the benchmark's tasks, one module a suite."""
