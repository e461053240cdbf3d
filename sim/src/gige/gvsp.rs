//! GVSP, the stream channel: one block as leader, payload packets and trailer, built packet by packet so that any of
//! them can be sent again.

use std::sync::Arc;

/// IP, UDP and GVSP headers: what a packet of a given size cannot use.
pub const OVERHEAD: usize = 36;
/// Payload type: an image.
const IMAGE: u16 = 0x0001;
/// Payload type: an image followed by chunks.
const IMAGE_WITH_CHUNKS: u16 = 0x4001;

/// One block ready for the wire.
#[derive(Debug, Clone)]
pub struct Block {
    /// Block id, 1 to 65535.
    pub id: u16,
    /// Time stamp in ticks.
    pub stamp: u64,
    /// Pixel format code.
    pub format: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The payload carries chunks.
    pub chunks: bool,
    /// Image and chunks.
    pub payload: Arc<Vec<u8>>,
    /// Packet size in force (with headers).
    pub packet_size: usize,
    /// The payload ends after this many bytes (fault).
    pub cut_at: Option<usize>,
}

// === impl Block ===

impl Block {
    fn room(&self) -> usize {
        self.packet_size.saturating_sub(OVERHEAD).max(8)
    }

    /// Payload packets of the whole block.
    pub fn payload_packets(&self) -> u32 {
        self.payload.len().div_ceil(self.room()) as u32
    }

    /// Number of the trailer; the leader is packet 0.
    pub fn trailer(&self) -> u32 {
        self.payload_packets() + 1
    }

    /// True where the packet exists and is not cut off by a fault.
    pub fn has(&self, packet: u32) -> bool {
        match self.cut_at {
            Some(cut) if packet >= 1 && packet <= self.payload_packets() => (packet - 1) as usize * self.room() < cut,
            Some(_) => packet == 0,
            None => packet <= self.trailer(),
        }
    }

    /// Writes a packet into `out`, replacing what was there. Nothing where it does not exist.
    pub fn packet(&self, packet: u32, out: &mut Vec<u8>) {
        out.clear();
        let kind = if self.chunks { IMAGE_WITH_CHUNKS } else { IMAGE };
        if packet == 0 {
            header(self.id, 1, 0, 0, out);
            out.extend_from_slice(&[0, 0]);
            out.extend_from_slice(&kind.to_be_bytes());
            out.extend_from_slice(&self.stamp.to_be_bytes());
            for word in [self.format, self.width, self.height, 0, 0, 0] {
                out.extend_from_slice(&word.to_be_bytes());
            }
        } else if packet <= self.payload_packets() {
            let start = (packet - 1) as usize * self.room();
            let end = (start + self.room()).min(self.payload.len());
            header(self.id, 3, packet, 0, out);
            out.extend_from_slice(self.payload.get(start..end).unwrap_or_default());
        } else if packet == self.trailer() {
            header(self.id, 2, packet, 0, out);
            out.extend_from_slice(&[0, 0]);
            out.extend_from_slice(&kind.to_be_bytes());
            out.extend_from_slice(&self.height.to_be_bytes());
            if self.chunks {
                out.extend_from_slice(&(self.payload.len() as u32).to_be_bytes());
                out.extend_from_slice(&[0; 4]);
            }
        }
    }
}

/// A packet header: status, block id, kind (1 leader, 2 trailer, 3 payload), packet id.
pub fn header(block: u16, kind: u8, packet: u32, code: u16, out: &mut Vec<u8>) {
    out.extend_from_slice(&code.to_be_bytes());
    out.extend_from_slice(&block.to_be_bytes());
    out.extend_from_slice(&(u32::from(kind) << 24 | (packet & 0xff_ffff)).to_be_bytes());
}

/// Appends a chunk: data, id, length.
pub fn push_chunk(payload: &mut Vec<u8>, id: u32, data: &[u8]) {
    payload.extend_from_slice(data);
    close_chunk(payload, id, data.len());
}

/// Closes the last `length` bytes as a chunk.
pub fn close_chunk(payload: &mut Vec<u8>, id: u32, length: usize) {
    payload.extend_from_slice(&id.to_be_bytes());
    payload.extend_from_slice(&(length as u32).to_be_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(bytes: usize, cut_at: Option<usize>) -> Block {
        Block {
            id: 0x15,
            stamp: 7,
            format: 0x0108_0001,
            width: 100,
            height: 10,
            chunks: false,
            payload: Arc::new((0..bytes).map(|i| i as u8).collect()),
            packet_size: 136,
            cut_at,
        }
    }

    #[test]
    fn a_block_is_leader_payload_and_trailer_and_its_bytes_come_back_in_order() {
        let block = block(250, None);
        let (mut packet, mut bytes) = (Vec::new(), Vec::new());
        for n in 0..=block.trailer() {
            block.packet(n, &mut packet);
            assert_eq!(&packet[..4], [0, 0, 0, 0x15]);
            assert_eq!(packet[4], [1, 3, 3, 3, 2][n as usize]);
            if packet[4] == 3 {
                assert!(packet.len() + 28 <= 136);
                bytes.extend_from_slice(&packet[8..]);
            }
        }
        assert_eq!(bytes, *block.payload);
        assert_eq!(block.trailer(), 4);
    }

    #[test]
    fn a_cut_block_has_neither_its_end_nor_its_trailer() {
        let block = block(250, Some(120));
        assert_eq!((0..=block.trailer()).filter(|n| block.has(*n)).collect::<Vec<_>>(), [0, 1, 2]);
    }
}
