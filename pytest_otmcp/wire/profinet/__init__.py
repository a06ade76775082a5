"""The codec of PROFINET IO: Ethernet frames with DCP and RT class 1, and datagrams with the remote procedure calls of acyclic services
(IEC 61158-6-10; the fields are public in the GSDML specification and in Wireshark). Nothing here is isochronous."""
