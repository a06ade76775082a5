"""pytest hooks of the kit."""
