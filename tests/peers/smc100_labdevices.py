"""Drives a SMC100 box at the port argv[1] with labdevices (PyVISA-py underneath); prints what it found as JSON."""
import json
import sys
import time

from labdevices.newport import SMC100

# A busy machine may take longer than the tenth of a second that the library grants.
SMC100.defaults["timeout"] = 5000
stage = SMC100(sys.argv[1])
stage.initialize()
found = {"idn": stage.idn, "state": stage.error_and_controller_status()}
stage.move_abs(5)
found["refused"] = stage.error_code[stage.get_last_command_error()]
stage.home()
while stage.error_and_controller_status()[1] == "1E":
    time.sleep(0.05)
stage.speed = 20
stage.move_abs(12.5)
found["moving"] = stage.is_moving
stage.wait_move_finish(0.05)
stage.move_rel(-2.5)
stage.wait_move_finish(0.05)
found["position"], found["speed"], found["error"] = stage.position, stage.speed, stage.get_last_command_error()
stage.move_abs(5000)
found["beyond"] = stage.error_code[stage.get_last_command_error()]
stage.reset()
found["reset"] = stage.error_and_controller_status()
stage.close()
print(json.dumps(found))
