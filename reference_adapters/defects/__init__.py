"""The catalogue's defects, each as a reference adapter that has this defect and no other (ids ``MU-nn``).

Nothing here is meant to be copied or connected to anything but a mock device. ``otmcp self-check`` and the kit's own tests
start these adapters in order to show that the suites notice the defects; no other code imports this package, and the command
that runs the reference adapters does not know it.
"""
