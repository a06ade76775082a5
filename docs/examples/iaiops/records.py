"""Prints the audit records of iaiops, which are rows of a database, as a JSON object on each line."""

import json
import sqlite3
import sys

with sqlite3.connect(f"file:{sys.argv[1]}?mode=ro", uri=True) as log:
    log.row_factory = sqlite3.Row
    for row in log.execute("SELECT * FROM audit_log ORDER BY id"):
        print(json.dumps({**dict(row), "params": json.loads(row["params"])}))
