"""The console: its gate, its forms, what it says of a call, and journeys through its page in a real browser."""
