"""Exemplary MCP-to-OT adapters: Modbus, MQTT with Sparkplug B, and OPC UA. Written to be read and copied.

``core`` is the code that they share and that a new adapter would start from; each protocol package has its connection,
its conversions and its tools.
"""
