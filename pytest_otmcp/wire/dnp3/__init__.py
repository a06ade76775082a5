"""The codec of DNP3 (IEEE 1815): link frames, transport segments, application fragments and their objects."""
