"""Defects of the catalogue that nobody notices yet, by what it takes to notice them."""

from __future__ import annotations

from collections.abc import Mapping

__all__ = ["GROUPS", "NOT_YET", "TOTAL"]

TOTAL = 129
"""Defects in the catalogue: MU-01 to MU-129."""

GROUPS: Mapping[str, str] = {
    "A": "what shows it happens today, and nobody looks",
    "B": "arguments that must be refused, and those at a bound",
    "C": "faults that the mock devices can already make",
    "D": "a device that is silent",
    "E": "operations that no task performs",
    "F": "special values and shapes",
    "G": "start and end of adapter and device",
    "H": "long runs",
    "I": "means of security that neither kit nor subject file have",
    "J": "a second unit or endpoint",
    "K": "a watch of more than a few seconds",
}

NOT_YET: Mapping[str, Mapping[str, str]] = {
    "A": {
        "MU-82": "The server's timestamp is the adapter's own time.",
        "MU-88": "Every reconnect leaves a session behind.",
        "MU-107": "The device's own words are in error.message.",
        "MU-114": "Over HTTP any Origin is accepted, from any network.",
        "MU-125": "Connecting again is tried without a pause.",
    },
    "B": {
        "MU-06": "Unit 257 is unit 1.",
        "MU-12": "true is written as 1.",
        "MU-43": "Of 126 registers 125 are read.",
        "MU-72": "A publish that failed uses up a sequence number.",
        "MU-73b": "Data of a device that was never born are published.",
        "MU-113b": "An argument of the wrong type ends the process.",
        "MU-122": "Ten megabytes are handed to the broker.",
        "MU-127b": "Data with a metric that the birth did not declare are published.",
    },
    "C": {
        "MU-16": "The device confirms another value than the one that was written, and nobody minds.",
        "MU-17": "The device cuts a value off, and the check after the write says nothing.",
        "MU-37": "Answers that come in another order are given to the wrong calls.",
        "MU-39": "An answer with any transaction identifier is accepted.",
        "MU-63": "A publish succeeds before its PUBACK.",
        "MU-64": "A subscription that the broker refuses is a success.",
        "MU-81u": "An Uncertain value is good.",
        "MU-87": "A Write that is not complete yet is told as checked.",
        "MU-119": "A connection that the broker refuses is a timeout.",
        "MU-129b": "BadUserAccessDenied is an internal error.",
    },
    "D": {
        "MU-25": "A write without an answer is sent again.",
        "MU-30": "A connection whose other end has vanished is waited for without end.",
        "MU-31": "The timeout that was set has no effect.",
        "MU-32": "Adapter and library both repeat, so twelve requests leave.",
        "MU-33": "A call that was cancelled is repeated further.",
        "MU-34": "A write that was cancelled counts as not executed.",
        "MU-38": "A late answer is given to the next call.",
        "MU-92": "A device that is silent holds up every other call.",
    },
    "E": {
        "MU-03": "The words of numbers of 32 bits are swapped when they are read.",
        "MU-18": "With writes disabled a mask write is sent.",
        "MU-19": "With writes disabled a method is called.",
        "MU-23": "Of a list with one forbidden write the others are written.",
        "MU-24": "A limit is compared with the raw value.",
        "MU-27": "A block of 200 registers is written in two requests.",
        "MU-28": "A mask write is a read and a write.",
        "MU-41": "The two registers of a float are read in two requests.",
        "MU-42": "Coils are read with the padding of their last byte.",
        "MU-61": "In a list of values there is the text of an error.",
        "MU-78": "The command to be born again has no effect.",
        "MU-79": "Commands to devices pass the write guard, or carry a sequence number.",
        "MU-121": "A scaled value is cut off instead of rounded.",
        "MU-128": "The metrics of a node that died stay good.",
    },
    "F": {
        "MU-55": "NaN is in the JSON as a word of its own.",
        "MU-56": "NaN becomes null or 0.",
        "MU-58": "Counters above 2^53 are rounded.",
        "MU-75": "Negative numbers are encoded as they are not to be.",
        "MU-83": "A single value is written into an array.",
        "MU-85": "A cycle of references is followed without end.",
        "MU-108": "Terminal codes and invisible characters of the device are passed on.",
        "MU-109": "A quotation mark of the device breaks the JSON.",
        "MU-123": "Messages that are no text are lost.",
    },
    "G": {
        "MU-54": "Tool descriptions hold names from the device.",
        "MU-62": "While the device is off, invalid input is a failed connection.",
        "MU-86": "After a restart of the server a namespace has its old index.",
    },
    "H": {
        "MU-71": "Sequence number 255 is left out.",
        "MU-89": "Messages that nobody reads are kept without a limit.",
        "MU-91": "Calls are taken without a limit.",
    },
    "I": {
        "MU-22": "Of a range that is to be written, the first register alone must be allowed.",
        "MU-94": "An argument names another host.",
        "MU-95": "An argument grants a role.",
        "MU-96": "A broker that is to be reached by TLS is reached without.",
        "MU-97": "Certificates are not verified.",
        "MU-98": "Where security cannot be agreed on, there is none.",
        "MU-99b": "A password is in the words of an error.",
        "MU-100": "The audit log has successful writes alone.",
        "MU-101": "Records of the audit log can be cut off.",
        "MU-102": "A write is sent although the audit log is full.",
        "MU-103": "A line break in a topic makes a record of its own.",
        "MU-104": "An argument counts as an approval.",
        "MU-105": "An approval holds for other arguments.",
        "MU-106": "An approval holds twice.",
        "MU-110": "The switch against all writes is read once.",
    },
    "J": {"MU-05": "Whatever unit is asked for, it is unit 1."},
    "K": {"MU-29c": "A publish that failed is made up for 20 seconds later."},
}
"""Group to id to what such an adapter does. Other variants of the same defect may be noticed."""
