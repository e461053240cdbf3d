"""Drives a FW212C at argv[1] and a SC10 at argv[2] with PyVISA-py's serial sessions; prints JSON."""
import json
import sys

import pyvisa

manager = pyvisa.ResourceManager("@py")
found = {}


def session(path, baud):
    return manager.open_resource(f"ASRL{path}::INSTR", baud_rate=baud, write_termination="\r", read_termination=">",
                                 timeout=20_000)


def ask(link, text):
    """The answer up to the prompt; the blank behind the prompt begins the next one."""
    return link.query(text).strip(" ")


with session(sys.argv[1], 115_200) as wheel:
    found["wheel"] = [ask(wheel, q) for q in ("*idn?", "pcount?", "speed=1", "pos=4", "pos?", "pos=13", "Pos?")]
with session(sys.argv[2], 9600) as shutter:
    found["shutter"] = [ask(shutter, q) for q in ("id?", "mode=3", "open=3000", "ens", "ens?", "closed?")]
    while ask(shutter, "ens?") == "ens?\r1\r":
        pass
    found["single"] = ask(shutter, "closed?")
print(json.dumps(found))
