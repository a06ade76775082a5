def write_figures(run, d): pass
