//! Going back by a snapshot: what follows must be what it would have been.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, Ordering};

use defmt::Display2Format;

use crate::rollout::{Board, Hash};

/// Bytes of a snapshot, at most: of a robot.
const BYTES: usize = 24 * 1024;

struct Room(UnsafeCell<[u8; BYTES]>);

// SAFETY: only `room` touches the content, and TAKEN makes it do so once.
unsafe impl Sync for Room {}

static ROOM: Room = Room(UnsafeCell::new([0; BYTES]));
static TAKEN: AtomicBool = AtomicBool::new(false);

/// The room, the first time. In images that take no snapshot it is not linked.
fn room() -> Option<&'static mut [u8]> {
    if TAKEN.swap(true, Ordering::Relaxed) {
        return None;
    }
    // SAFETY: the line above lets one caller pass, so this is the only reference.
    Some(unsafe { &mut *ROOM.0.get() })
}

/// Takes a step that does not count, and goes back to before it by a snapshot, whose bytes it reports.
pub fn go_back(board: &mut Board<'_>, name: &'static str) -> Result<(), &'static str> {
    let room = room().ok_or("the room of the snapshot is taken")?;
    let Ok(length) = board.snapshot(room) else { return Err("the snapshot has no room") };
    let bytes = room.get(..length).unwrap_or_default();
    if board.step().is_err() {
        return Err("a step was refused");
    }
    if let Err(error) = board.restore(bytes) {
        defmt::error!("restore: {}", Display2Format(&error));
        return Err("a snapshot was refused");
    }
    let mut hash = Hash::default();
    bytes.iter().for_each(|byte| hash.add_byte(*byte));
    defmt::info!("{=str}: snapshot of {=usize} bytes {=u64:016x}", name, length, hash.value());
    Ok(())
}
