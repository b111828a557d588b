//! Contacts in blocks that sweeps take together. Those that change the motion of one unit keep the order of a sweep, and others do not
//! depend on each other, so that of finite numbers the bits are those of contacts one by one.

use super::bodies::{Bodies, Mover, World};
use super::contacts::{Blocks, Contact, Contacts, Held, ToPack};
use crate::kernels::{Block, FIELDS, NOBODY, WIDE, at, put};
use crate::scene::UnitSlot;

/// Numbers of blocks, a unit of a copy: room for 24 contacts, and for lanes that are left over. None where no kernels sweep over
/// blocks.
pub(super) const NUMBERS: usize =
    if cfg!(any(test, target_arch = "x86_64")) { 32 * FIELDS } else { 0 };
/// Fewer contacts are not worth it.
const FEWEST: usize = 3 * WIDE;

/// Puts the contacts of a substep, which are in order, into blocks, but where there are too few for that, or too many for the room.
pub(super) fn pack(world: &World<'_>, bodies: &Bodies<'_>, contacts: &mut Contacts<'_>) {
    let packed = packed(world, bodies, contacts);
    contacts.set_packed(packed);
}

fn packed(world: &World<'_>, bodies: &Bodies<'_>, contacts: &mut Contacts<'_>) -> Option<Blocks> {
    if contacts.rows().len() < FEWEST || world.gives_way() {
        return None;
    }
    let ToPack { rows, notes, blocks, middles, .. } = contacts.unpacked();
    let count = rows.len();
    let mut filled = 0;
    let mut ends = [0; 2];
    for ((start, end), filled_there) in [(0, middles), (middles, count)].into_iter().zip(&mut ends)
    {
        // The first block of the part, and the first that has room.
        let (base, mut open) = (filled, filled);
        notes.iter_mut().for_each(|[_, _, _, _, behind, ..]| *behind = base as f32);
        for place in start..end {
            let [_, number, ..] = notes.get(place)?;
            let number = *number as usize;
            let contact = Contact::read(rows.get(number)?);
            let moved = |unit: usize| {
                world.units.get(unit).is_some_and(UnitSlot::is_free).then(|| bodies.root_of(unit))
            };
            let movers = [contact.from.and_then(moved), moved(contact.to)];
            let behind = |mover: &usize| {
                notes.get(*mover).map_or(0, |[_, _, _, _, behind, ..]| *behind as usize)
            };
            let mut at = movers.iter().flatten().map(behind).fold(open, usize::max);
            while at < filled
                && notes.get(at).is_some_and(|[_, _, _, _, _, lanes, ..]| *lanes as usize == WIDE)
            {
                if at == open {
                    open += 1;
                }
                at += 1;
            }
            if at == filled {
                let block = blocks.get_mut(at)?;
                *block = [[0.0; WIDE]; FIELDS];
                let [_, _, _, _, _, first, second, ..] = block;
                (*first, *second) = ([NOBODY; WIDE], [NOBODY; WIDE]);
                let [_, _, _, _, _, lanes, ..] = notes.get_mut(at)?;
                *lanes = 0.0;
                filled += 1;
            }
            for mover in movers.into_iter().flatten() {
                let [_, _, _, _, behind, ..] = notes.get_mut(mover)?;
                *behind = (at + 1) as f32;
            }
            let [_, _, _, _, _, lanes, ..] = notes.get_mut(at)?;
            let lane = *lanes as usize;
            *lanes += 1.0;
            fill(blocks.get_mut(at)?, lane, world, bodies, (number, &contact));
        }
        *filled_there = filled;
    }
    let [middles, all] = ends;
    Some(Blocks { middles, all })
}

/// Puts a contact into a block.
fn fill(
    block: &mut Block,
    lane: usize,
    world: &World<'_>,
    bodies: &Bodies<'_>,
    (number, contact): (usize, &Contact),
) {
    let row_of = |unit: usize| bodies.root_of(unit) as f32;
    let from = contact.from.map_or(Mover::STILL, |from| bodies.mover(from));
    let to = bodies.mover(contact.to);
    let ([own, other], [n, t, _]) = (contact.arms, contact.axes());
    let [arm, twist, heavy_twist] = contact.twist().unwrap_or_default();
    let ([along, across, aside], [heavy, heavy_across, heavy_aside]) =
        (contact.impulse, contact.weight);
    let held = match contact.held {
        Held::Neither => 0.0,
        Held::From => -1.0,
        Held::To => 1.0,
    };
    let ([xx, yy, zz, xy, xz, yz], [uu, vv, ww, uv, uw, vw]) = (from.inverse, to.inverse);
    #[rustfmt::skip]
    let numbers = [along, across, aside, twist, number as f32, contact.from.map_or(NOBODY, row_of), row_of(contact.to),
        own.x, own.y, own.z, other.x, other.y, other.z, n.x, n.y, n.z, t.x, t.y, t.z,
        heavy, heavy_across, heavy_aside, contact.stiffness, contact.wanted(world.substep_s), contact.rebound, contact.friction,
        held, if contact.is_middle { 1.0 } else { 0.0 }, arm, heavy_twist,
        from.lightness, xx, yy, zz, xy, xz, yz, to.lightness, uu, vv, ww, uv, uw, vw];
    for (there, number) in block.iter_mut().zip(numbers) {
        put(there, lane, number);
    }
}

/// Takes the impulses of contacts out of their blocks.
pub(super) fn unpack(contacts: &mut Contacts<'_>) {
    let ToPack { rows, blocks, packed, .. } = contacts.unpacked();
    for block in blocks.iter().take(packed.map_or(0, |blocks| blocks.all)) {
        let [along, across, aside, twist, number, _, to, ..] = block;
        for lane in 0..WIDE {
            if at(to, lane) == NOBODY {
                break;
            }
            let Some(row) = rows.get_mut(at(number, lane) as usize) else { continue };
            Contact::write_impulse(&[along, across, aside].map(|of| at(of, lane)), row);
            if Contact::is_middle(row) {
                Contact::write_twist(at(twist, lane), row);
            }
        }
    }
}
