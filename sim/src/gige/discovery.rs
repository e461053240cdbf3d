//! Broadcast discovery: a twin that is to be found without its address listens where clients call all cameras at once.

use super::PORT;
use super::address as a;
use super::gvcp::{self, Request};
use super::shared::Shared;
use rustix::net::{AddressFamily, SocketType, bind, socket, sockopt};
use std::io;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::sync::Arc;
use std::time::Duration;

/// A socket that hears calls to all, beside those of other twins of this machine.
///
/// # Errors
/// The address cannot be bound.
pub fn listen() -> io::Result<UdpSocket> {
    let fd = socket(AddressFamily::INET, SocketType::DGRAM, None)?;
    sockopt::set_socket_reuseaddr(&fd, true)?;
    bind(&fd, &SocketAddrV4::new(Ipv4Addr::BROADCAST, PORT))?;
    let heard = UdpSocket::from(fd);
    heard.set_read_timeout(Some(Duration::from_millis(50)))?;
    Ok(heard)
}

/// Answers calls from the camera's own address until the twin is stopped.
pub fn serve(shared: &Arc<Shared>, heard: &UdpSocket, answers: &UdpSocket) {
    let mut datagram = [0_u8; 64];
    while shared.alive() {
        let Ok((length, from)) = heard.recv_from(&mut datagram) else { continue };
        let Ok(envelope) = gvcp::parse(datagram.get(..length).unwrap_or_default()) else { continue };
        let deaf = shared.faults().deaf;
        if deaf || envelope.request != Request::Discovery {
            continue;
        }
        if let Ok(data) = shared.registers().read(0, a::DISCOVERY_END as usize) {
            let _ = answers.send_to(&gvcp::answer(0, envelope.command, envelope.id, &data), from);
        }
    }
}
