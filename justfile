# `just` lists the recipes. It is one file to install: https://just.systems, or `pip install rust-just`.

bin := ".venv/bin"

[private]
default:
    @just --list --unsorted

# Make the environment; once for each clone.
setup:
    python3 -m venv .venv
    {{bin}}/pip install --quiet -c constraints.txt -e ".[dev]"

# What each commit has to pass: lint, format, import contracts, types. Half a minute, seconds when mypy is warm.
check:
    {{bin}}/ruff check .
    {{bin}}/ruff format --check .
    {{bin}}/lint-imports
    {{bin}}/mypy pytest_otmcp mocks reference_adapters conformance benchmarks

# Let ruff mend what it can.
fix:
    {{bin}}/ruff check --fix .
    {{bin}}/ruff format .

# The fast lane of the tests, or a part of it: just fast tests/unit -k envelope
fast *ARGS="tests":
    {{bin}}/pytest -n auto --dist worksteal {{ARGS}}

# The long lane: LaTeX, browser, foreign broker, wheel, 30 repetitions.
long *ARGS="tests":
    {{bin}}/pytest -m long -n 6 --dist worksteal {{ARGS}}

# The weekly lane: every variant of a defect, every honest adapter. Hours.
weekly *ARGS="tests":
    {{bin}}/pytest -m weekly -n 4 --dist worksteal {{ARGS}}

# Does every declaration have what it needs? Rows, checks, defects, pages, protocols.
house:
    {{bin}}/pytest -q -n auto tests/house

# Exit code 1 says here that the run is not the whole suite; the lines above it say what passed.
# Run a benchmark item or a check at the reference adapters: just item M3, just item WR-003, just item K3 --otmcp-protocols=s7
[no-exit-message]
item ID *OPTIONS:
    {{bin}}/pytest -q --otmcp-suite=normal,fault,stress,recovery,requirements -k '{{ if ID =~ '^[A-Z]{2,3}-[0-9]{3}$' { ID + "." } else { "[" + ID + "]" } }}' {{OPTIONS}}

# Start the adapter with a defect and show what notices it: just defect MU-14
defect +IDS:
    {{bin}}/otmcp self-check {{IDS}}

# Judge stored records by the oracles of this checkout; without a name the golden ones.
judge *RECORDS="tests/data/golden/*.gz":
    {{bin}}/otmcp judge {{RECORDS}}

# Make golden records again, after a change of steps: just golden 'reference-*'
golden *NAMES:
    {{bin}}/python -m tests.golden make {{NAMES}}

# Write the documentation with its built pages into build/docs.
docs:
    {{bin}}/otmcp docs ./build/docs

# Build the site of the documentation into build/site; a broken link fails. Look at it with: python -m http.server -d build/site
site: docs
    {{bin}}/zensical build --clean --strict

# Print what the changelog of the next release will say.
news:
    {{bin}}/uv tool run towncrier build --draft --version next

# Build sdist and wheel into dist.
wheel:
    {{bin}}/uv build
