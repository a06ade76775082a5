"""Certificates: what a finished run has to meet, and the statement that is made of it. Pure: functions of a run record."""
