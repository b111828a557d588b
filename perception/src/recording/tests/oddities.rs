//! Recordings with something odd: what is left out is told, and the rest is read.

use super::*;

fn notes_of(captures: &Captures) -> Vec<String> {
    captures.notes().iter().map(|(note, count)| format!("{count} {note}")).collect()
}

/// Captures of a folder by their times, and what is said.
fn times_and_notes(path: &Path, rate_hz: Option<f64>) -> (Vec<f64>, Vec<f32>, Vec<String>) {
    let options = Options { rate_hz, ..Options::default() };
    let mut captures = open_with(path, &options).unwrap();
    let read: Vec<Capture> = captures.by_ref().map(Result::unwrap).collect();
    let first = |capture: &Capture| match capture.views.as_slice() {
        [View::Cloud(cloud)] => cloud.points[0].x,
        _ => panic!("no cloud"),
    };
    let times = read.iter().map(|capture| capture.time_s).collect();
    (times, read.iter().map(first).collect(), notes_of(&captures))
}

/// A cloud whose first point is at this x.
fn ply_at(x: f64) -> String {
    let header = "ply\nformat ascii 1.0\nelement vertex 2\n";
    let properties = "property double x\nproperty double y\nproperty double z\nend_header\n";
    format!("{header}{properties}{x} 0 1\n0 0.5 1\n")
}

#[test]
fn one_bad_image_costs_itself_alone() {
    for bad in [&b"\x89PNG\r\n\x1a\n"[..], b"", b"GIF89a"] {
        let (_folder, path) = folder();
        recorded(&path, 3);
        fs::write(path.join("00002-left.png"), bad).unwrap();
        let mut captures = open(&path).unwrap();
        let read: Vec<Capture> = captures.by_ref().map(Result::unwrap).collect();
        let views: Vec<usize> = read.iter().map(|capture| capture.views.len()).collect();
        assert_eq!(views.iter().sum::<usize>(), 5, "{views:?}");
        let notes = notes_of(&captures);
        assert!(notes.len() == 1 && notes[0].contains("00002-left.png"), "{notes:?}");
        assert_eq!(captures.notes().left_out(), 1);
    }
}

#[test]
fn names_are_in_the_order_of_their_numbers_and_hidden_files_are_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    for number in 1..=12 {
        fs::write(folder.path().join(format!("{number}.ply")), ply_at(f64::from(number))).unwrap();
    }
    for hidden in ["._1.ply", ".2.pcd", "._frames.json"] {
        fs::write(folder.path().join(hidden), b"\x00\x05\x16\x07").unwrap();
    }
    let (times, firsts, notes) = times_and_notes(folder.path(), Some(10.0));
    assert_eq!(times.len(), 12);
    assert_eq!(firsts, (1..=12).map(|number| number as f32).collect::<Vec<_>>());
    assert_eq!(notes, ["2 hidden files are passed over, such as .2.pcd"]);
    assert!(
        open(folder.path()).is_err_and(|error| matches!(error.problem, CaptureProblem::NoRate))
    );
}

#[test]
fn names_that_are_times_are_the_times() {
    let unpadded = ["899.850000000", "899.950000000", "900.50000000", "900.150000000"];
    let tum = ["1305031102.175304", "1305031102.275304", "1305031102.375304", "1305031102.475304"];
    let milliseconds = ["1700000000900", "1700000001000", "1700000001100", "1700000001200"];
    for names in [unpadded, tum, milliseconds] {
        let folder = tempfile::tempdir().unwrap();
        for (number, name) in names.iter().enumerate() {
            let path = folder.path().join(format!("{name}.ply"));
            fs::write(path, ply_at(number as f64 + 1.0)).unwrap();
        }
        for rate_hz in [None, Some(30.0)] {
            let (times, firsts, notes) = times_and_notes(folder.path(), rate_hz);
            assert!(
                times.iter().zip([0.0, 0.1, 0.2, 0.3]).all(|(a, b)| (a - b).abs() < 1e-6),
                "{times:?}"
            );
            assert_eq!(firsts, [1.0, 2.0, 3.0, 4.0]);
            assert!(notes.len() == 1 && notes[0].contains("names of the files"), "{notes:?}");
        }
    }
}

#[test]
fn fields_of_no_numbers_take_no_bytes() {
    let header = "VERSION 0.7\nFIELDS x y z _ ring _ label\nSIZE 4 4 4 1 1 1 2\nTYPE F F F U U U U\n\
        COUNT 1 1 1 4 1 0 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA ";
    let mut bytes = format!("{header}binary\n").into_bytes();
    for x in [1.5_f32, 2.5] {
        bytes.extend([x, 0.0, 1.0].iter().flat_map(|number| number.to_le_bytes()));
        bytes.extend([9, 9, 9, 9, 7, 3, 0]);
    }
    let ascii = format!("{header}ascii\n1.5 0 1 9 9 9 9 7 3\n2.5 0 1 9 9 9 9 7 3\n");
    for bytes in [bytes, ascii.into_bytes()] {
        let cloud = cloud(&bytes).unwrap();
        assert_eq!(cloud.points, [Point3::new(1.5, 0.0, 1.0), Point3::new(2.5, 0.0, 1.0)]);
        assert_eq!(cloud.labels, Some(vec![3, 3]));
    }
    let none = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 0\nPOINTS 0\nDATA binary\n";
    assert!(cloud(none.as_bytes()).unwrap_err().to_string().contains("no x, y and z"));
}

#[test]
fn organised_clouds_and_texts_that_are_no_numbers_lose_those_points() {
    let header = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\n\
        property float z\nproperty list uchar int ids\nproperty uchar label\nend_header\n";
    let text = format!(
        "{header}0 0 0 0 1\nnan nan nan 0 2\n-nan(ind) 0 1.#QNAN 2 7 8 3\n+inf 0 0 0 4\n1 0 0 1 6 5\n"
    );
    let read = cloud(text.as_bytes()).unwrap();
    assert_eq!(read.points, [Point3::new(0.0, 0.0, 0.0), Point3::new(1.0, 0.0, 0.0)]);
    assert_eq!(read.labels, Some(vec![1, 5]));
    assert!(cloud(text.replace("1 6 5", "1 6").as_bytes()).is_err(), "a line that is short");
    assert!(cloud(text.replace("+inf", "north").as_bytes()).is_err());
    let organised = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 2\n\
        POINTS 4\nDATA ascii\nnan nan nan\n1 2 3\n4 5 6\n-nan nan nan\n";
    assert_eq!(cloud(organised.as_bytes()).unwrap().points.len(), 2);
}

#[test]
fn coordinates_far_away_have_an_offset_taken_from_them() {
    let folder = tempfile::tempdir().unwrap();
    let header = "VERSION 0.7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 3\nHEIGHT 1\n\
        VIEWPOINT 456010 5428060 2 1 0 0 0\nPOINTS 3\nDATA binary\n";
    for number in 0..3 {
        let mut bytes = header.as_bytes().to_vec();
        for k in 0..3 {
            let point = [456_012.25 + f64::from(k), 5_428_059.5 + 0.001 * f64::from(number), 1.0];
            bytes.extend(point.iter().flat_map(|v| v.to_le_bytes()));
        }
        fs::write(folder.path().join(format!("{number}.pcd")), bytes).unwrap();
    }
    let mut captures = open_at(folder.path(), 10.0).unwrap();
    let read: Vec<Capture> = captures.by_ref().map(Result::unwrap).collect();
    for (number, capture) in read.iter().enumerate() {
        let [View::Cloud(cloud)] = capture.views.as_slice() else { panic!() };
        let wanted = Point3::new(12.25, -40.5 + 0.001 * number as f32, 1.0);
        assert!((cloud.points[0] - wanted).norm() < 1e-5, "{}", cloud.points[0]);
        assert_eq!(cloud.sensor, Some(Point3::new(10.0, -40.0, 2.0)));
    }
    assert_eq!(
        notes_of(&captures),
        ["1 coordinates are far from the origin: 456000, 5428100, 0 m are subtracted from x, y, z"]
    );
    // Four bytes have lost the shape already.
    let coarse = String::from_utf8(binary_pcd()[..PCD.len() + 12].to_vec()).unwrap();
    let mut bytes = coarse.into_bytes();
    for x in [456_012.0_f32, 456_012.5] {
        bytes.extend([x, 5_428_059.0, 1.0, 5.0].iter().flat_map(|v| v.to_le_bytes()));
        bytes.extend([1, 0]);
    }
    let error = cloud(&bytes).unwrap_err().to_string();
    assert!(error.contains("cloud.pcd") && error.contains("subtract an offset"), "{error}");
}

#[test]
fn points_of_beams_without_a_return_are_left_out_and_told() {
    let folder = tempfile::tempdir().unwrap();
    let body = "0 0 0\n0 0 0\n1 0 0\n0 0 0\n2 0 0\n9e6 0 0\n";
    let header = "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    fs::write(folder.path().join("1.ply"), format!("{header}{body}")).unwrap();
    let mut captures = open_at(folder.path(), 10.0).unwrap();
    let capture = captures.next().unwrap().unwrap();
    let [View::Cloud(cloud)] = capture.views.as_slice() else { panic!() };
    assert_eq!(cloud.points.len(), 2);
    let notes = notes_of(&captures);
    assert!(
        notes[0].starts_with("3 points at 0,0,0") && notes[1].starts_with("1 points beyond"),
        "{notes:?}"
    );
}
