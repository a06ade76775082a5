import json, time, os
import pytest
from tests.soundness.conftest import HERE, IMPATIENT, failing, words
from pytest_otmcp.suite.catalogue import tasks_by_id
from tests.soundness.mutants.table import MUTANTS
@pytest.mark.parametrize("name", MUTANTS)
def test_x(judge, name):
    m = MUTANTS[name]
    t = time.time(); c = os.times()
    tasks = " ".join(i for i in tasks_by_id() if m.recovers or not i.startswith("R-"))
    r = judge(m.protocol, "mutants/program.py", name, tasks=tasks, time_scale=IMPATIENT if m.waits else 1.0)
    d=os.times()
    reqs = {}
    for i, x in r.items():
        for fs in (x["findings"], *(s["findings"] for s in x["samples"])):
            for f in fs: reqs.setdefault(str(f["requirement"]), []).append(i+": "+f["message"][:230])
    st = {i: x["status"] for i,x in r.items() if x["status"] not in ("PASS","FAIL")}
    with open("/tmp/mutants_explore.jsonl","a") as out:
        out.write(json.dumps({"id":name,"items":" ".join(i for i in tasks_by_id() if i in failing(r)),"reqs":reqs,"odd":st,"s":time.time()-t,"cpu":d.user+d.children_user-c.user-c.children_user})+"\n")
