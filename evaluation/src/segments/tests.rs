use super::*;

/// A row of labels for each line; a dot is 0.
fn image(rows: &[&str]) -> (Vec<u16>, [u32; 2]) {
    let labels = rows.iter().flat_map(|row| row.chars());
    let labels = labels.map(|c| c.to_digit(10).unwrap_or(0) as u16).collect();
    (labels, [rows[0].len() as u32, rows.len() as u32])
}

fn of(found: &[&str], truth: &[&str]) -> SegmentsScore {
    let ((found, size), (truth, _)) = (image(found), image(truth));
    score(&found, &truth, None, size).unwrap()
}

#[test]
fn the_same_bodies_under_other_numbers_are_all_found() {
    let score = of(&["..33..", ".9335.", ".9.55."], &["..11..", ".2114.", ".2.44."]);
    let all = Rates { precision: 1.0, recall: 1.0, f: 1.0 };
    assert_eq!((score.overlap, score.boundary, score.support), (all, all, 1.0));
    assert_eq!((score.objects, score.segments, score.found_50, score.found_75), (3, 3, 3, 3));
    assert_eq!(score.found_shares(), [1.0, 1.0]);
}

#[test]
fn two_bodies_that_are_merged_count_for_the_larger() {
    // 8 pixels found, 6 of them on the larger body, 2 on the other.
    let score = of(&[".1111.", ".1111."], &[".1112.", ".1112."]);
    assert_eq!(score.overlap, Rates { precision: 0.75, recall: 0.75, f: 0.75 });
    assert_eq!((score.objects, score.segments, score.found_50, score.found_75), (2, 1, 1, 1));
}

#[test]
fn support_in_a_segment_costs_precision() {
    // Both bodies are found whole; of 3 free pixels a segment has 2.
    let score = of(&["111122", "12222."], &["11113.", "1333.."]);
    assert_eq!((score.objects, score.segments), (2, 2));
    assert!((score.overlap.precision - 9.0 / 11.0).abs() < 1e-12, "{score:?}");
    assert_eq!(score.overlap.recall, 1.0);
    assert!((score.support - 1.0 / 3.0).abs() < 1e-12, "{score:?}");
    // 4 of 6: found at .5 alone.
    assert_eq!((score.found_50, score.found_75), (2, 1));
}

#[test]
fn the_assignment_is_the_best_one_and_not_the_first() {
    // In order of numbers segment 1 would get body 1, and segment 2 nothing.
    let score = of(&["111122"], &["221111"]);
    // F of 1-1: 2 * 2 / 8 = .5, of 2-1: 2 * 2 / 6 = .667, of 1-2: 2 * 2 / 6 = .667.
    assert_eq!(score.overlap.precision, 4.0 / 6.0);
    assert_eq!((score.found_50, score.found_75), (2, 0));
}

#[test]
fn boundaries_agree_within_a_tolerance() {
    // A diagonal of 283 pixels: 3 pixels, rounded up.
    let square = |from: usize, to: usize| -> Vec<u16> {
        let is_in =
            |at: usize| (from..to).contains(&(at % 200)) && (from..to).contains(&(at / 200));
        (0..200 * 200).map(|at| u16::from(is_in(at))).collect()
    };
    let of = |found: &[u16]| score(found, &square(50, 150), None, [200, 200]).unwrap();
    assert_eq!(of(&square(52, 148)).boundary.f, 1.0);
    assert_eq!(of(&square(40, 160)).boundary, Rates::default());
    let overlap = of(&square(40, 160)).overlap;
    assert_eq!((overlap.recall, overlap.precision), (1.0, 10_000.0 / 14_400.0));
}

#[test]
fn nothing_at_all_is_right_and_nothing_of_something_is_not() {
    let (nothing, all) = (Rates::default(), Rates { precision: 1.0, recall: 1.0, f: 1.0 });
    let score = of(&["...."], &["...."]);
    assert_eq!((score.overlap, score.boundary, score.found_shares()), (all, all, [1.0, 1.0]));
    assert_eq!(of(&["...."], &[".11."]).overlap, nothing);
    assert_eq!(of(&[".11."], &["...."]).overlap, nothing);
    assert_eq!(of(&[".11."], &["1..1"]).overlap, nothing);
    assert_eq!(super::score(&[], &[], None, [0, 0]).unwrap().overlap, all);
}

#[test]
fn pixels_without_depth_do_not_count() {
    let (found, size) = image(&["11..", "11.."]);
    let (truth, _) = image(&["11.1", "1.11"]);
    let depths = [9, 9, 9, 0, 9, 0, 0, 0];
    let score = score(&found, &truth, Some(&depths), size).unwrap();
    assert_eq!((score.overlap.f, score.support, score.objects), (1.0, 1.0, 1));
}

#[test]
fn images_that_cannot_be_compared_are_refused() {
    let size = [64, 64];
    let many: Vec<u16> = (0..4096).collect();
    let plain = vec![1; 4096];
    let text = |error: SegmentsError| error.to_string();
    assert!(text(score(&many, &plain, None, size).unwrap_err()).contains("4095 segments"));
    assert!(text(score(&plain, &many, None, size).unwrap_err()).contains("4095 bodies"));
    assert!(text(score(&plain[1..], &plain, None, size).unwrap_err()).contains("4095 labels"));
    assert!(text(score(&plain, &plain, Some(&[]), size).unwrap_err()).contains("0 depths"));
}

#[test]
fn means_are_over_images_and_counts_are_summed() {
    let one = of(&[".11."], &[".11."]);
    let none = of(&["...."], &[".11."]);
    let mean = mean(&[one, none]).unwrap();
    assert_eq!((mean.overlap.f, mean.objects, mean.found_50), (0.5, 2, 1));
    assert_eq!(mean.found_shares(), [0.5, 0.5]);
    assert_eq!(super::mean(&[]), None);
}
