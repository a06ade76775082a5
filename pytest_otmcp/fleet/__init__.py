"""Many adapters and versions: a plan with a row for each, what became of the rows, and one matrix of all of them.

The engine between plan and matrix is Snakemake, whose workflow is ``Snakefile`` in this folder. A row is one isolated
certification; :mod:`pytest_otmcp.cli.fleet_row` carries it out, on whatever machine the engine chooses.
"""
