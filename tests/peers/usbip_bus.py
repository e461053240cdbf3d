"""A pyusb backend that reaches devices over USB/IP, so that programs for pyusb need neither a kernel's bus nor a cable.

`plug_into("127.0.0.1:3240")` makes it the backend that pyusb finds in this process. Wire format: the kernel's
Documentation/usb/usbip_protocol.rst.
"""
import array
import errno
import os
import select
import socket
import struct
import threading
from types import SimpleNamespace

import usb.backend
import usb.backend.libusb1
import usb.core

VERSION = 0x0111
LIST, IMPORT = 0x8005, 0x8003
SUBMIT, UNLINK, SUBMITTED, UNLINKED = 1, 2, 3, 4
HEAD = struct.Struct(">HHI")
LISTED = struct.Struct(">256s32sIIIHHHBBBBBB")
COMMAND = struct.Struct(">IIIIIIiiii8s")
REPLY = struct.Struct(">IIIIIiiiii8x")
# Longest wait for a server that answers at all, seconds.
PATIENCE = 5.0

DEVICE = ("<BBHBBBBHHHBBBB", "bLength bDescriptorType bcdUSB bDeviceClass bDeviceSubClass bDeviceProtocol bMaxPacketSize0 "
          "idVendor idProduct bcdDevice iManufacturer iProduct iSerialNumber bNumConfigurations")
CONFIGURATION = ("<BBHBBBBB", "bLength bDescriptorType wTotalLength bNumInterfaces bConfigurationValue iConfiguration "
                 "bmAttributes bMaxPower")
INTERFACE = ("<BBBBBBBBB", "bLength bDescriptorType bInterfaceNumber bAlternateSetting bNumEndpoints bInterfaceClass "
             "bInterfaceSubClass bInterfaceProtocol iInterface")
ENDPOINT = ("<BBBBHB", "bLength bDescriptorType bEndpointAddress bmAttributes wMaxPacketSize bInterval")


def parse(shape, raw):
    layout, names = shape
    fields = dict(zip(names.split(), struct.unpack_from(layout, raw)))
    return SimpleNamespace(**fields, extra_descriptors=[], bRefresh=0, bSynchAddress=0)


def fail(code):
    kind = usb.core.USBTimeoutError if code == errno.ETIMEDOUT else usb.core.USBError
    raise kind(os.strerror(code), -code, code)


def receive(sock, size):
    data = bytearray()
    while len(data) < size:
        part = sock.recv(size - len(data))
        if not part:
            fail(errno.ENODEV)
        data += part
    return bytes(data)


class Remote:
    """A device at the server; its connection is shared by all who have it open."""

    def __init__(self, server, busid, numbers):
        self.server, self.busid = server, busid
        self.bus, self.address, self.speed = numbers
        self.lock = threading.RLock()
        self.sock, self.users, self.number = None, 0, 0
        self.descriptors = {}

    def open(self):
        with self.lock:
            if self.sock is None:
                self.sock = socket.create_connection(self.server, PATIENCE)
                self.sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self.sock.sendall(HEAD.pack(VERSION, IMPORT, 0) + self.busid.encode().ljust(32, b"\0"))
                _, _, status = HEAD.unpack(receive(self.sock, HEAD.size))
                if status:
                    self.sock = None
                    fail(errno.EBUSY)
                receive(self.sock, LISTED.size)
            self.users += 1
        return self

    def close(self, all_users=False):
        with self.lock:
            self.users = 0 if all_users else max(0, self.users - 1)
            if self.users == 0 and self.sock is not None:
                self.sock.close()
                self.sock = None

    def transfer(self, endpoint, setup, size, out, timeout):
        """One transfer: gives the bytes that came, or raises what a bus would."""
        with self.lock:
            if self.sock is None:
                fail(errno.ENODEV)
            self.number += 1
            number, read = self.number, out is None
            devid = self.bus << 16 | self.address
            self.sock.sendall(COMMAND.pack(SUBMIT, number, devid, int(read), endpoint & 0x0F, 0, size, 0, 0, 0, setup)
                              + (out or b""))
            if not select.select([self.sock], [], [], timeout / 1000 if timeout else None)[0]:
                self.number += 1
                self.sock.sendall(COMMAND.pack(UNLINK, self.number, devid, 0, 0, number, 0, 0, 0, 0, bytes(8)))
            result = None
            while True:
                kind, of, _, _, _, status, length, *_ = REPLY.unpack(receive(self.sock, REPLY.size))
                if kind == SUBMITTED:
                    data = receive(self.sock, length) if read and length > 0 else b""
                    result = (status, data)
                if of == self.number:
                    break
            if result is None:
                fail(errno.ETIMEDOUT)
            if result[0]:
                fail(-result[0])
            return result[1]

    def descriptor(self, kind, size):
        """A standard descriptor, asked for once."""
        if kind not in self.descriptors:
            self.open()
            try:
                setup = struct.pack("<BBHHH", 0x80, 6, kind << 8, 0, size)
                self.descriptors[kind] = self.transfer(0, setup, size, None, 2000)
            finally:
                self.close()
        return self.descriptors[kind]

    def tree(self):
        """Interfaces with their alternates and endpoints."""
        raw, interfaces, at = self.descriptor(2, 4096), {}, 0
        while at + 2 <= len(raw) and raw[at] >= 2:
            part = raw[at:at + raw[at]]
            if part[1] == 4:
                interface = parse(INTERFACE, part)
                interface.endpoints = []
                interfaces.setdefault(interface.bInterfaceNumber, []).append(interface)
            elif part[1] == 5 and interfaces:
                interface.endpoints.append(parse(ENDPOINT, part))
            at += raw[at]
        return list(interfaces.values())


class UsbIpBus(usb.backend.IBackend):
    """All devices of one server."""

    def __init__(self, server):
        self.server, self.known = server, {}

    def enumerate_devices(self):
        with socket.create_connection(self.server, PATIENCE) as sock:
            sock.sendall(HEAD.pack(VERSION, LIST, 0))
            receive(sock, HEAD.size)
            for _ in range(struct.unpack(">I", receive(sock, 4))[0]):
                fields = LISTED.unpack(receive(sock, LISTED.size))
                receive(sock, 4 * fields[-1])
                busid = fields[1].split(b"\0")[0].decode()
                yield self.known.setdefault(busid, Remote(self.server, busid, fields[2:5]))

    def get_parent(self, dev):
        return None

    def get_device_descriptor(self, dev):
        found = parse(DEVICE, dev.descriptor(1, 18))
        found.bus, found.address, found.speed = dev.bus, dev.address, dev.speed
        found.port_number, found.port_numbers = dev.address, (dev.address,)
        return found

    def get_configuration_descriptor(self, dev, config):
        if config:
            raise IndexError(config)
        return parse(CONFIGURATION, dev.descriptor(2, 4096))

    def get_interface_descriptor(self, dev, intf, alt, config):
        return dev.tree()[intf][alt]

    def get_endpoint_descriptor(self, dev, ep, intf, alt, config):
        return dev.tree()[intf][alt].endpoints[ep]

    def open_device(self, dev):
        return dev.open()

    def close_device(self, dev_handle):
        dev_handle.close()

    def reset_device(self, dev_handle):
        dev_handle.close(all_users=True)
        dev_handle.open()

    def ctrl_transfer(self, dev_handle, bmRequestType, bRequest, wValue, wIndex, data, timeout):
        size = len(data) * data.itemsize
        setup = struct.pack("<BBHHH", bmRequestType, bRequest, wValue, wIndex, size)
        if bmRequestType & 0x80:
            return fill(data, dev_handle.transfer(0, setup, size, None, timeout))
        dev_handle.transfer(0, setup, size, data.tobytes(), timeout)
        return size

    def order(self, dev_handle, kind, request, value, index):
        self.ctrl_transfer(dev_handle, kind, request, value, index, array.array("B"), 2000)

    def set_configuration(self, dev_handle, config_value):
        self.order(dev_handle, 0, 9, config_value, 0)

    def get_configuration(self, dev_handle):
        answer = array.array("B", [0])
        self.ctrl_transfer(dev_handle, 0x80, 8, 0, 0, answer, 2000)
        return answer[0]

    def set_interface_altsetting(self, dev_handle, intf, altsetting):
        self.order(dev_handle, 1, 11, altsetting, intf)

    def clear_halt(self, dev_handle, ep):
        self.order(dev_handle, 2, 1, 0, ep)

    def claim_interface(self, dev_handle, intf):
        pass

    def release_interface(self, dev_handle, intf):
        pass

    def bulk_write(self, dev_handle, ep, intf, data, timeout):
        dev_handle.transfer(ep, bytes(8), len(data), data.tobytes(), timeout)
        return len(data)

    def bulk_read(self, dev_handle, ep, intf, buff, timeout):
        return fill(buff, dev_handle.transfer(ep, bytes(8), len(buff), None, timeout))

    def is_kernel_driver_active(self, dev_handle, intf):
        return False


def fill(buffer, data):
    buffer[:len(data)] = array.array(buffer.typecode, data)
    return len(data)


def plug_into(address):
    """From now on pyusb sees the devices of the server at `host:port` and no others."""
    host, port = address.rsplit(":", 1)
    bus = UsbIpBus((host, int(port)))
    usb.backend.libusb1.get_backend = lambda find_library=None: bus
    return bus
