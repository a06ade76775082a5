def write_tables(run, d): pass
