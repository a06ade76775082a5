"""pytest-otmcp: the conformance kit for MCP-to-OT adapters, in which the device is the witness."""

__version__ = "0.1.0"
