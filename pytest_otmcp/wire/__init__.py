"""The codecs: bytes of the wire and what they say, one module or package for each protocol. Pure.

A mock and the kit use the same codec; what makes the kit independent of an adapter is that no reference adapter does, and foreign
programs' traffic in the tests. A mock is a program of its own that has to start quickly, so nothing here imports more than it needs.
"""
