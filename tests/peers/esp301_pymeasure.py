"""Drives an ESP301 at the port argv[1] with PyMeasure; prints what it found as JSON."""
import json
import sys

from pymeasure.adapters import SerialAdapter
from pymeasure.instruments.newport import ESP300

adapter = SerialAdapter(sys.argv[1], baudrate=921600, timeout=30, write_termination="\r", read_termination="\r\n")
esp = ESP300(adapter)
esp.clear_errors()
found = {"before": bool(esp.x.enabled), "units": esp.x.units}
esp.x.position = 5
found["refused"] = [str(e) for e in esp.errors]
esp.x.enable()
esp.x.home()
esp.x.wait_for_stop()
found["home"] = esp.x.position
esp.x.position = 12.5
esp.x.wait_for_stop()
found["position"] = esp.x.position
esp.x.right_limit = 90
found["limit"] = esp.x.right_limit
esp.x.position = 100
found["beyond"] = [str(e) for e in esp.errors]
esp.x.disable()
found["after"] = bool(esp.x.enabled)
print(json.dumps(found))
