"""The codec of MQTT and of the Sparkplug messages in it."""
