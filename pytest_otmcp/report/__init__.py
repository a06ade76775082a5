"""Everything that is made from a run record: terminal summary, LaTeX tables, figures. Nothing here judges."""
