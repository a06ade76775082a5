"""Certificates: the conditions for a finished run, and the statement made from it. Pure: functions of a run record."""
