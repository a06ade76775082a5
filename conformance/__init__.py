"""What is required: the benchmark's tasks, a module for each protocol, one for what crosses them."""
