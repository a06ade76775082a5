"""The console: reply, wire and device side by side in a browser on this machine.

``gate`` lets the page of this process in and nobody else, ``server`` serves page and interface, ``bench`` has one adapter at its mock
device, ``witness`` follows the device's journal, ``reading`` says what a call claims beside what the device saw, ``tools`` describes
tools and ``form`` makes a form of a schema, ``copying`` makes tests and bindings of calls, ``records`` opens run records, ``runs``
starts the suite, ``prompt`` lets an assistant call the tools. Nothing here judges an adapter: verdicts are the suite's.
"""
