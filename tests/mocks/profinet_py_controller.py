"""profinet-py (GPL-3.0), in a process of its own, as a controller of the mock: records, then cyclic data. It prints what it was told, as JSON."""

import json
import logging
import sys
import time

from profinet import PNIOError, cyclic, rpc, rt, util

interface, name = sys.argv[1:]
logging.disable(logging.WARNING)
frames, mac = util.ethernet_socket(interface), util.get_mac(interface)
station = rpc.get_station_info(frames, mac, name)
told: dict[str, object] = {"name": station.name, "ip": station.ip}

supervisor = rpc.RPCCon(station, timeout=5.0)
supervisor.connect(mac)
supervisor.write(0, 1, 1, 1, (250).to_bytes(2, "big"))
told["record"] = supervisor.read(0, 1, 1, 1).payload.hex()
told["order"] = supervisor.read_im0().order_id.decode().strip()
try:
    supervisor.write(0, 1, 1, 1, (5000).to_bytes(2, "big"))
    told["refused"] = False
except PNIOError:
    told["refused"] = True
supervisor.disconnect()

controller = rpc.RPCCon(rpc.get_station_info(frames, mac, name), timeout=5.0)
setup = rpc.IOCRSetup(
    slots=[
        rpc.IOSlot(1, 1, input_length=8, module_ident=0x10, submodule_ident=1),
        rpc.IOSlot(2, 1, output_length=8, module_ident=0x20, submodule_ident=1),
    ]
)
answer = controller.connect(mac, iocr_setup=setup)
controller.prm_end()
controller.application_ready(5)


def agreed(kind: int, frame_id: int) -> rt.IOCRConfig:
    places = [
        rt.IODataObject(
            slot=slot.slot,
            subslot=slot.subslot,
            frame_offset=offset,
            data_length=0 if consumed else length,
            iops_offset=offset if consumed else offset + length,
        )
        for slot, length, offset, consumed in rpc._iter_iocr_layout(setup.slots, kind)
    ]
    return rt.IOCRConfig(
        iocr_type=kind,
        iocr_reference=kind,
        frame_id=frame_id,
        send_clock_factor=32,
        reduction_ratio=32,
        watchdog_factor=6,
        data_length=40,
        objects=places,
    )


cycle = cyclic.CyclicController(
    interface, mac, util.s2mac(station.mac), agreed(1, answer.input_frame_id), agreed(2, answer.output_frame_id)
)
cycle.start()
cycle.set_output_data(2, 1, bytes(range(1, 9)))
deadline = time.monotonic() + 20
while not any(cycle.get_input_data(1, 1) or b"") and time.monotonic() < deadline:
    time.sleep(0.05)
told["inputs"] = bytes(cycle.get_input_data(1, 1) or b"").hex()
print(json.dumps(told), flush=True)
sys.stdin.readline()
cycle.stop()
controller.disconnect()
