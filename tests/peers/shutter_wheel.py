"""Drives a FW212C at argv[1] and a SC10 at argv[2] over pyserial alone, as terminal programs do; prints JSON."""
import json
import sys

import serial


def ask(port, text):
    """Everything up to the ready prompt."""
    port.write(text.encode() + b"\r")
    return port.read_until(b"> ").decode()


found = {}
with serial.Serial(sys.argv[1], 115200, timeout=20) as port:
    ask(port, "")
    found["wheel"] = ask(port, "*idn?")
    found["moved"] = ask(port, "pos=5")
    found["place"] = ask(port, "pos?")
with serial.Serial(sys.argv[1], 115200, timeout=20) as port:
    found["reopened"] = ask(port, "pos?")
with serial.Serial(sys.argv[2], 9600, timeout=5) as port:
    ask(port, "")
    found["opened"] = [ask(port, "ens"), ask(port, "ens?")]
print(json.dumps(found))
