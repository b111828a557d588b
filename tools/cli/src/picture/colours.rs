//! What units are drawn in.

use rigidformer_core::Role;

use super::page::Rgb;

/// Colours that are told apart also without colour vision for the first eight; then they repeat.
const COLOURS: [Rgb; 10] = [
    [0.26, 0.53, 0.84],
    [0.95, 0.58, 0.20],
    [0.25, 0.66, 0.44],
    [0.87, 0.33, 0.36],
    [0.58, 0.45, 0.78],
    [0.96, 0.80, 0.30],
    [0.30, 0.72, 0.80],
    [0.90, 0.52, 0.72],
    [0.62, 0.47, 0.36],
    [0.60, 0.63, 0.68],
];

const DRIVEN: Rgb = [0.24, 0.26, 0.30];
const FIXED: Rgb = [0.76, 0.76, 0.74];

/// A colour of their own for free units; driven ones are dark, fixed ones grey.
pub(crate) fn colour(unit: usize, role: Role) -> Rgb {
    match role {
        Role::Driven => DRIVEN,
        Role::Fixed => FIXED,
        _ => COLOURS[unit % COLOURS.len()],
    }
}

/// What [`colour`] means, for scenes in which not all units are free.
pub(super) fn legend(roles: impl Iterator<Item = Role>) -> &'static str {
    let (mut driven, mut fixed) = (false, false);
    for role in roles {
        driven |= role == Role::Driven;
        fixed |= role == Role::Fixed;
    }
    match (driven, fixed) {
        (true, true) => "driven units are dark, fixed ones grey",
        (true, false) => "driven units are dark",
        (false, true) => "fixed units are grey",
        (false, false) => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn legends_name_the_roles_that_there_are() {
        let of = |roles: &[Role]| legend(roles.iter().copied());
        assert_eq!(of(&[Role::Free, Role::Free]), "");
        assert_eq!(of(&[Role::Free, Role::Fixed]), "fixed units are grey");
        assert_eq!(of(&[Role::Driven, Role::Fixed]), "driven units are dark, fixed ones grey");
    }
}
