"""The proof that the suites notice what they must: reference adapters with known defects, and what a run over each shows.

- ``defect``: the defects as their package declares them, and which of them somebody asks for;
- ``judging``: one defective adapter at the devices of a plant, judged by the items that must notice it and those beside them;
  ``among_genuine`` is its bench, ``warm_start`` starts its adapters in a tenth of the time;
- ``worker``: a process that judges one defect after another; ``pool``: several of them;
- ``kill_matrix``: what was noticed, by what, and whether that is what was to be.
"""
