from tests.soundness.conftest import *
from tests.soundness.honest.zoo import ZOO


def test_it(judge):
    for name, items in PAIRS:
        c = ZOO[name]
        r = judge(c.protocol, "honest/adapter.py", name, described=c.described, tasks=items)
        print("==", name)
        for i, x in r.items():
            print(i, x["status"], x["reason"] or "")
            for fs in (x["findings"], *(s["findings"] for s in x["samples"])):
                for f in fs:
                    print("   ", f["strength"], f["requirement"], f["code"], f["message"][:400])


PAIRS = [("opcua/subscription-in-every-session", "REC-006.opcua")]
