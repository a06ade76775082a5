"""The catalogue's defects, each as a reference adapter that has this defect and no other (issue numbers ``MU-nn``)."""
