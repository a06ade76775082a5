"""One MCP session with an adapter: its process, its transport, every frame recorded with its time. Does not judge."""
