"""Golden records: small run records of every protocol, whose judgement must stay as it is.

Each is an adapter whose judgement is known, at its mock devices, once. ``python -m tests.golden make`` makes them, the tests of this
package judge them again with the oracles of this checkout, and ``otmcp judge`` shows what has changed.
"""
