"""The devices of a run: mock devices as processes of their own, an external broker behind the tap, and the tap itself."""
