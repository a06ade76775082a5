"""Benchmarks of the adapters' cost, against floors of the same run: ``pytest benchmarks``. See docs/performance.md."""
