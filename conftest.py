"""Of this checkout only: lets the kit's own tests run pytest inside pytest."""

pytest_plugins = ["pytester"]
