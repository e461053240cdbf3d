"""Lets INDI's Optec driver turn the wheel at the port argv[1]: speaks INDI's XML to the driver's own program; prints JSON."""
import json
import os
import re
import select
import subprocess
import sys
import time
from xml.etree.ElementTree import XMLPullParser

DEVICE = "Optec IFW"
driver = subprocess.Popen(["indi_optec_wheel"], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                          stderr=subprocess.DEVNULL, bufsize=0)
parser, messages, values = XMLPullParser(["end"]), [], {}
parser.feed("<stream>")


def say(kind, name, **members):
    one = "".join(f'<one{kind} name="{n}">{v}</one{kind}>' for n, v in members.items())
    driver.stdin.write(f'<new{kind}Vector device="{DEVICE}" name="{name}">{one}</new{kind}Vector>\n'.encode())


def wait(what, limit):
    """Reads the driver's stream until `what()` holds."""
    end = time.monotonic() + limit
    while not what():
        if not select.select([driver.stdout], [], [], max(0, end - time.monotonic()))[0]:
            raise SystemExit(f"nothing after {limit} s; values {values}; messages {messages}")
        data = os.read(driver.stdout.fileno(), 65536).decode()
        if not data:
            raise SystemExit(f"the driver ended; values {values}; messages {messages}")
        parser.feed(re.sub(r"<\?xml.*?\?>", "", data))
        for _, element in parser.read_events():
            if element.get("message"):
                messages.append(element.get("message"))
            if element.tag.endswith("Vector"):
                values[element.get("name")] = (element.get("state"), {e.get("name"): (e.text or "").strip() for e in element})


driver.stdin.write(b'<getProperties version="1.7"/>\n')
wait(lambda: "DEVICE_PORT" in values and "CONNECTION" in values, 10)
say("Text", "DEVICE_PORT", PORT=sys.argv[1])
if "DEVICE_AUTO_SEARCH" in values:
    say("Switch", "DEVICE_AUTO_SEARCH", INDI_DISABLED="On")
say("Switch", "CONNECTION", CONNECT="On")
wait(lambda: "FILTER_SLOT" in values, 60)
found = {"properties": sorted(values)}
say("Number", "FILTER_SLOT", FILTER_SLOT_VALUE="4")
wait(lambda: values["FILTER_SLOT"] [0] == "Ok" and float(values["FILTER_SLOT"][1]["FILTER_SLOT_VALUE"]) == 4, 40)
found["slot"] = values["FILTER_SLOT"][1]["FILTER_SLOT_VALUE"]
found["names"] = values.get("FILTER_NAME", ("", {}))[1]
say("Switch", "CONNECTION", DISCONNECT="On")
wait(lambda: values["CONNECTION"][1].get("DISCONNECT") == "On", 10)
driver.stdin.close()
driver.wait(10)
found["messages"] = messages
print(json.dumps(found))
