"""One MCP session with an adapter: its process, its transport, and a record of every frame with its time. Does not judge."""
