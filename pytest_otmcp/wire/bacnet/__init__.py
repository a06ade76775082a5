"""The codec of BACnet/IP (ASHRAE 135): the layers around APDUs, tagged data, and what requests and answers say."""
