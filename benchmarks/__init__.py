"""What the adapters cost, measured against floors of the same run: ``pytest benchmarks``. See docs/performance.md."""
