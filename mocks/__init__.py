"""The plant: mock devices, each a program of its own with journal, image, faults and a 1 Hz simulation.

``python -m pytest_otmcp.mocks modbus --port 1502`` starts one by hand; any client of the protocol may use it. See
``launcher`` for what the program prints and reads, ``control`` for what a device can be asked, ``packages`` and ``device``
for what a new protocol has to implement. A protocol may live in a folder of this package or anywhere else: ``python -m
pytest_otmcp.mocks vendor.protocol.mock``.
"""
