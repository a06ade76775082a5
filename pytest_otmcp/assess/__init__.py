"""The assessment of assistants: tasks in words, put to a model or an agent that has an adapter, and judged by what the device saw.

``place`` has the adapters at their mock devices for one try, ``relay`` stands between assistant and adapter and keeps every call,
``served`` offers relays over HTTP and ``shim`` over standard streams, ``fitting`` tells whether a call is an operation, ``claims`` reads an
answer, ``scoring`` judges a try, ``agent`` runs a command for each try and ``engine`` the models of Inspect, ``campaign`` goes through the
tries, ``results`` is the file, ``figures`` and ``report`` are made from it. No model judges, and nothing here is part of a certificate: an
assessment says something about an assistant with an adapter.
"""
