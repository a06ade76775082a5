"""The codec of EtherNet/IP: encapsulation, messages of CIP, and what requests and answers say."""
