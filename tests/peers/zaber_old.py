"""Drives a Zaber chain at the port argv[1] with the vendor's older library zaber.serial; prints JSON."""
import json
import sys

from zaber.serial import AsciiCommand, AsciiDevice, AsciiSerial

port = AsciiSerial(sys.argv[1])
port.timeout = 10
port.write(AsciiCommand("get system.serial"))
found = {"serials": [port.read().data for _ in range(3)]}
stage = AsciiDevice(port, 2)
axis = stage.axis(1)
found["before"] = axis.send("").warning_flag
found["home"] = axis.home().reply_flag
found["after"] = axis.send("").warning_flag
axis.move_abs(12800)
axis.move_rel(-2800)
found["position"] = axis.get_position()
found["refused"] = axis.move_abs(10**9).data
axis.move_vel(-20000)
found["status"] = axis.get_status()
axis.stop()
found["unknown"] = stage.send("get nonsense").data
found["echo"] = stage.send("tools echo one two").data
stage.send("set comm.checksum 1")
found["checksum"] = stage.send("get comm.checksum").checksum
port.close()
print(json.dumps(found))
