//! The control thread: answers GVCP requests, keeps privilege and heartbeat, resends stream packets.

use super::address as a;
use super::faults::Draws;
use super::gvcp::{self, Envelope, Request};
use super::gvsp;
use super::registers::{Effect, status};
use super::shared::{Order, Shared, pause};
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::Sender;
use std::time::Duration;
use tokio::time::Instant;

/// One twin's control side.
pub struct Control {
    shared: Arc<Shared>,
    socket: UdpSocket,
    stream: UdpSocket,
    orders: Sender<Order>,
    last_heard: Instant,
    losses: Draws,
    scratch: Vec<u8>,
}

// === impl Control ===

impl Control {
    /// A control side on an open socket; stream packets leave through `stream`.
    pub fn new(shared: Arc<Shared>, socket: UdpSocket, stream: UdpSocket, orders: Sender<Order>) -> Control {
        let losses = Draws::new(shared.config.seed ^ 0x5eed);
        Control { shared, socket, stream, orders, last_heard: Instant::now(), losses, scratch: Vec::new() }
    }

    /// Serves until the twin is stopped.
    pub fn run(mut self) {
        let mut datagram = [0_u8; 2048];
        let _ = self.socket.set_read_timeout(Some(Duration::from_millis(5)));
        while self.shared.alive() {
            let heard = self.socket.recv_from(&mut datagram);
            // A twin that hung while it waited answers only after the thaw, or never.
            if !self.shared.alive() {
                break;
            }
            self.watch_heartbeat();
            let deaf = self.shared.faults().deaf;
            if let Ok((length, SocketAddr::V4(from))) = heard
                && !deaf
            {
                self.serve(datagram.get(..length).unwrap_or_default(), from);
            }
        }
        let _ = self.orders.send(Order::Quit);
    }

    fn watch_heartbeat(&mut self) {
        let limit = Duration::from_millis(u64::from(self.shared.registers().get(a::HEARTBEAT_MS)));
        let held = self.shared.controller().is_some();
        if held && self.last_heard.elapsed() > limit {
            self.shared.traffic().heartbeats_missed += 1;
            drop_control(&self.shared, &self.orders);
        }
    }

    fn serve(&mut self, datagram: &[u8], from: SocketAddrV4) {
        let (reply, wants_answer) = match gvcp::parse(datagram) {
            Ok(Envelope { request: Request::Resend { block, first, last }, .. }) => {
                return self.resend(block, first, last);
            }
            Ok(e) => {
                if *self.shared.controller() == Some(from) {
                    self.last_heard = Instant::now();
                }
                let reply = match self.carry_out(&e.request, from) {
                    Ok(data) => gvcp::answer(0, e.command, e.id, &data),
                    Err(code) => {
                        self.shared.traffic().refused += 1;
                        gvcp::answer(code, e.command, e.id, &[])
                    }
                };
                (reply, e.wants_answer)
            }
            Err(Some((code, command, id))) => (gvcp::answer(code, command, id, &[]), true),
            Err(None) => return,
        };
        let late = self.shared.faults().slow_answer;
        if let Some(late) = late {
            let due = Instant::now() + late;
            while Instant::now() < due && self.shared.alive() {
                pause(due - Instant::now());
            }
        }
        if wants_answer {
            let _ = self.socket.send_to(&reply, from);
        }
    }

    fn carry_out(&mut self, request: &Request, from: SocketAddrV4) -> Result<Vec<u8>, u16> {
        match request {
            Request::Discovery => self.shared.registers().read(0, a::DISCOVERY_END as usize),
            Request::ReadRegisters(addresses) => {
                let mut data = Vec::new();
                for address in addresses {
                    data.extend(self.read(*address, 4)?);
                }
                Ok(data)
            }
            Request::ReadMemory { address, count } => {
                let mut data = address.to_be_bytes().to_vec();
                data.extend(self.read(*address, *count)?);
                Ok(data)
            }
            Request::WriteRegisters(pairs) => {
                for (address, value) in pairs {
                    self.write(*address, &value.to_be_bytes(), from)?;
                }
                Ok((pairs.len() as u32).to_be_bytes().to_vec())
            }
            Request::WriteMemory { address, data } => {
                self.write(*address, data, from)?;
                Ok((data.len() as u32).to_be_bytes().to_vec())
            }
            Request::Resend { .. } | Request::Unknown => Err(status::NOT_IMPLEMENTED),
        }
    }

    fn read(&self, address: u32, count: usize) -> Result<Vec<u8>, u16> {
        let factor = self.shared.faults().wrong_readback;
        if address == a::EXPOSURE
            && count == 8
            && let Some(factor) = factor
        {
            let wrong = self.shared.registers().get_f64(a::EXPOSURE) * factor;
            return Ok(wrong.to_be_bytes().to_vec());
        }
        self.shared.registers().read(address, count)
    }

    fn write(&mut self, address: u32, data: &[u8], from: SocketAddrV4) -> Result<(), u16> {
        if address == a::PRIVILEGE {
            return self.set_privilege(data, from);
        }
        let lax = self.shared.faults().lax_access;
        if !lax && *self.shared.controller() != Some(from) {
            return Err(status::ACCESS_DENIED);
        }
        let effect = self.shared.registers().write(address, data)?;
        match effect {
            Effect::None => {}
            Effect::Start => {
                self.shared.registers().acquiring = true;
                self.order(Order::Start);
            }
            Effect::Stop => {
                self.shared.registers().acquiring = false;
                self.order(Order::Stop);
            }
            Effect::Trigger => self.order(Order::Trigger),
            Effect::TestPacket => self.send_test_packet(),
            Effect::Latch => {
                let ticks = self.shared.ticks(Instant::now());
                let mut registers = self.shared.registers();
                registers.put(a::STAMP_HIGH, (ticks >> 32) as u32);
                registers.put(a::STAMP_HIGH + 4, ticks as u32);
            }
            Effect::Reset => {
                self.order(Order::Stop);
                self.shared.forget();
            }
        }
        Ok(())
    }

    fn set_privilege(&mut self, data: &[u8], from: SocketAddrV4) -> Result<(), u16> {
        let wanted = data.get(..4).and_then(|d| d.try_into().ok()).map_or(0, u32::from_be_bytes) & 3;
        let holder = *self.shared.controller();
        if holder.is_some_and(|h| h != from) || (holder.is_none() && wanted == 0) {
            return Err(status::ACCESS_DENIED);
        }
        if wanted == 0 {
            drop_control(&self.shared, &self.orders);
        } else {
            *self.shared.controller() = Some(from);
            if holder.is_none() {
                self.shared.taken.store(true, Ordering::SeqCst);
            }
            self.shared.registers().put(a::PRIVILEGE, wanted);
            self.last_heard = Instant::now();
        }
        Ok(())
    }

    fn order(&self, order: Order) {
        let _ = self.orders.send(order);
    }

    fn send_test_packet(&self) {
        let (to, size) = destination(&self.shared);
        let _ = self.stream.send_to(&vec![0; size.saturating_sub(28)], to);
    }

    fn resend(&mut self, id: u16, first: u32, last: u32) {
        let faults = self.shared.faults().clone();
        if faults.mute {
            return;
        }
        let (to, _) = destination(&self.shared);
        let block = self.shared.kept(id);
        for n in first..=last.min(first.saturating_add(65_536)) {
            match &block {
                Some(block) if n > block.trailer() => break,
                Some(block) if block.has(n) && !faults.refuse_resend => block.packet(n, &mut self.scratch),
                _ => {
                    self.scratch.clear();
                    gvsp::header(id, 3, n, status::PACKET_UNAVAILABLE, &mut self.scratch);
                }
            }
            let mut traffic = self.shared.traffic();
            traffic.packets += 1;
            traffic.resent += 1;
            if self.losses.happens(faults.drop_per_1000) {
                traffic.dropped += 1;
            } else {
                let _ = self.stream.send_to(&self.scratch, to);
            }
            if block.is_none() {
                break;
            }
        }
    }
}

/// Where the stream goes and how big its packets are.
pub fn destination(shared: &Shared) -> (SocketAddrV4, usize) {
    let registers = shared.registers();
    let ip = Ipv4Addr::from(registers.get(a::STREAM_ADDRESS));
    let port = (registers.get(a::STREAM_PORT) & 0xffff) as u16;
    (SocketAddrV4::new(ip, port), (registers.get(a::PACKET_SIZE) & 0xffff) as usize)
}

/// Nobody controls the camera any more: privilege 0, stream closed, acquisition stopped.
pub fn drop_control(shared: &Shared, orders: &Sender<Order>) {
    *shared.controller() = None;
    let mut registers = shared.registers();
    registers.put(a::PRIVILEGE, 0);
    registers.put(a::STREAM_PORT, 0);
    registers.put(a::PARAMETERS_LOCKED, 0);
    registers.acquiring = false;
    let _ = orders.send(Order::Stop);
}
