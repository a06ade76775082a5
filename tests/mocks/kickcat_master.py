"""KickCAT, a second master beside SOEM: it sets the slaves up, reads and writes an object, and takes a slave to OP; it prints what it saw."""

import json
import struct
import sys

import kickcat as k

link = k.create_link(sys.argv[1], "")
# Its own two milliseconds are too few for a busy machine.
link.set_timeout(1.0)
bus = k.Bus(link)
bus.init(0.1)
slaves = list(bus.slaves() if callable(bus.slaves) else bus.slaves)
name = bytes(bus.read_sdo(slaves[1], 0x1008, 0, k.Access.PARTIAL, 32, 1.0)).rstrip(b"\0").decode()

read = struct.unpack("<i", bytes(bus.read_sdo(slaves[1], 0x2001, 5, k.Access.PARTIAL, 4, 1.0)))[0]
bus.create_mapping()
bus.request_state(k.State.SAFE_OP)
bus.wait_for_state(k.State.SAFE_OP, 2.0)
slaves[0].set_output_bytes(bytes([3, 4]))
slaves[1].set_output_bytes(bytes(8))
bus.process_data_no_check()
bus.request_state(k.State.OPERATIONAL)
bus.wait_for_state(k.State.OPERATIONAL, 2.0, bus.process_data_no_check)
for _ in range(3):
    bus.process_data()
sizes = [(one.input_size, one.output_size) for one in slaves]
print(json.dumps({"sizes": sizes, "name": name, "read": read, "inputs": list(bytes(slaves[0].input_data)[:2])}))
