"""MQTT and Sparkplug B: description, operations, decoders and oracles."""
