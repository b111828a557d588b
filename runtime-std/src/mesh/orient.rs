//! Faces that look the same way.

use std::collections::HashMap;

/// The triangles turned so that neighbours look the same way, where each edge has two of them. None where an edge has another number, or
/// where they cannot: a Moebius strip.
pub(super) fn turned(triangles: &[[u32; 3]]) -> Option<Vec<[u32; 3]>> {
    let mut sides: HashMap<(u32, u32), [Option<usize>; 2]> = HashMap::new();
    for (number, face) in triangles.iter().enumerate() {
        for (from, to) in edges(face) {
            let slots = sides.entry((from.min(to), from.max(to))).or_default();
            *slots.iter_mut().find(|slot| slot.is_none())? = Some(number);
        }
    }
    let mut turned = triangles.to_vec();
    let mut is_done = vec![false; triangles.len()];
    for start in 0..triangles.len() {
        if is_done[start] {
            continue;
        }
        is_done[start] = true;
        let mut open = vec![start];
        while let Some(at) = open.pop() {
            for (from, to) in edges(&turned[at]) {
                let [Some(a), Some(b)] = *sides.get(&(from.min(to), from.max(to)))? else {
                    return None;
                };
                let other = if a == at { b } else { a };
                let runs_alike = edges(&turned[other]).contains(&(from, to));
                match (runs_alike, is_done[other]) {
                    (true, true) => return None,
                    (true, false) => turned[other].swap(1, 2),
                    (false, _) => {}
                }
                if !is_done[other] {
                    is_done[other] = true;
                    open.push(other);
                }
            }
        }
    }
    Some(turned)
}

fn edges([a, b, c]: &[u32; 3]) -> [(u32, u32); 3] {
    [(*a, *b), (*b, *c), (*c, *a)]
}
