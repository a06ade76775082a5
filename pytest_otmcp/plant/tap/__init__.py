"""The tap: a proxy between adapter and device that records both directions and injects faults of the network."""
