"""MQTT and Sparkplug B: decoders and oracles."""
