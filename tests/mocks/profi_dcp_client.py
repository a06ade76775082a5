"""profi-dcp, in a process of its own, as a client of the mock's DCP. It prints what it was told, as JSON."""

import json
import sys

from profi_dcp.profi_dcp import DCP

client = DCP(sys.argv[1])
found = {device.name_of_station: device for device in client.identify_all(1)}
mac = found["kit-neighbour"].MAC
told: dict[str, object] = {name: [device.MAC, device.IP] for name, device in found.items()}
told["set"] = bool(client.set_name_of_station(mac, "kit-three"))
told["name"] = client.get_name_of_station(mac)
told["blinks"] = bool(client.blink(mac))
print(json.dumps(told), flush=True)
