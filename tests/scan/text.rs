//! Tables of points: names, guesses, counts, delimiters.

use glam::{DVec3, Vec3};
use proptest::prelude::*;

use super::*;

/// What a table has, besides places.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Extra {
    Intensity,
    Normals,
    Colours,
}

#[derive(Clone, Debug)]
struct Written {
    places: Vec<[f64; 3]>,
    normals: Vec<Vec3>,
    colours: Vec<[u8; 3]>,
    extras: Vec<Extra>,
    delimiter: &'static str,
    line_end: &'static str,
}

impl Written {
    fn header(&self) -> String {
        let mut names = vec!["X", "Y", "Z"];
        for extra in &self.extras {
            match extra {
                Extra::Intensity => names.push("Intensity [dB]"),
                Extra::Normals => names.extend(["Nx", "Ny", "Nz"]),
                Extra::Colours => names.extend(["R", "G", "B"]),
            }
        }
        if self.delimiter.trim().is_empty() {
            names.join(self.delimiter).replace(" [dB]", "[dB]") + self.line_end
        } else {
            names.join(self.delimiter) + self.line_end
        }
    }

    fn body(&self) -> String {
        let mut text = String::new();
        for (i, place) in self.places.iter().enumerate() {
            let mut words: Vec<String> = place.iter().map(|x| format!("{x:?}")).collect();
            for extra in &self.extras {
                match extra {
                    Extra::Intensity => words.push(format!("{}", -100 + i as i32)),
                    Extra::Normals => {
                        let normal = self.normals[i].to_array();
                        words.extend(normal.map(|x| format!("{x:?}")));
                    }
                    Extra::Colours => words.extend(self.colours[i].map(|x| x.to_string())),
                }
            }
            text += &(words.join(self.delimiter) + self.line_end);
        }
        text
    }

    fn check(&self, cloud: &PointCloud) -> Result<(), TestCaseError> {
        let places: Vec<DVec3> = self.places.iter().copied().map(DVec3::from).collect();
        prop_assert_eq!(&cloud.positions, &places);
        if self.extras.contains(&Extra::Normals) {
            prop_assert_eq!(&cloud.normals, &self.normals);
        } else {
            prop_assert!(cloud.normals.is_empty());
        }
        for (reflectance, colour) in cloud.reflectance.iter().zip(&self.colours) {
            let expected = if self.extras.contains(&Extra::Colours) {
                let linear = |byte: u8| match f32::from(byte) / 255.0 {
                    x if x <= 0.04045 => x / 12.92,
                    x => ((x + 0.055) / 1.055).powf(2.4).min(0.9),
                };
                Vec3::from(colour.map(linear))
            } else {
                Vec3::splat(0.5)
            };
            prop_assert!((*reflectance - expected).length() < 1e-6);
        }
        prop_assert!(cloud.repairs.is_empty(), "{:?}", cloud.repairs);
        Ok(())
    }
}

fn written() -> impl Strategy<Value = Written> {
    use Extra::{Colours, Intensity, Normals};
    let place = [-1e6..1e6f64, -1e6..1e6, -1e3..1e3];
    let normal = [-1f32..1.0, -1f32..1.0, 0.1f32..1.0].prop_map(|v| Vec3::from(v).normalize());
    let points = prop::collection::vec((place, normal, any::<[u8; 3]>()), 2..60);
    let extras = prop::sample::select(vec![
        vec![],
        vec![Intensity],
        vec![Colours],
        vec![Normals],
        vec![Intensity, Colours],
        vec![Colours, Normals],
        vec![Normals, Colours],
        vec![Intensity, Colours, Normals],
    ]);
    let delimiter = prop::sample::select(vec![" ", "\t", ",", ";", ", ", "   "]);
    let line_end = prop::sample::select(vec!["\n", "\r\n", "\r"]);
    (points, extras, delimiter, line_end).prop_map(|(points, extras, delimiter, line_end)| {
        let mut colours: Vec<[u8; 3]> = points.iter().map(|p| p.2).collect();
        colours[0] = [200, 3, 7]; // some colour is bright
        Written {
            places: points.iter().map(|p| p.0).collect(),
            normals: points.iter().map(|p| p.1).collect(),
            colours,
            extras,
            delimiter,
            line_end,
        }
    })
}

proptest! {
    #[test]
    fn tables_are_read_with_names_and_without(written in written()) {
        let (body, header) = (written.body(), written.header());
        let end = written.line_end;
        let count = format!("{}{end}", written.places.len());
        for text in [
            body.clone(),
            header.clone() + &body,
            format!("//{header}{body}"),
            format!("# made by hand{end}{end}# {header}{count}{body}"),
            format!("{count}{body}"),
            format!("{header}{count}{body}{end}{end}"),
            format!("\u{feff}{header}{body}"),
        ] {
            written.check(&read(text.as_bytes()).unwrap())?;
        }
        let twice = read(format!("{count}{body}{count}{body}").as_bytes()).unwrap();
        prop_assert_eq!(twice.len(), 2 * written.places.len());
    }

    #[test]
    fn damaged_files_do_no_harm(
        written in written(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let mut bytes = (written.header() + &written.body()).into_bytes();
        for (place, byte) in changes {
            let place = place.index(bytes.len());
            bytes[place] = byte;
        }
        sound(&bytes, "csv");
        sound(&bytes, "");
    }

    #[test]
    fn random_text_does_no_harm(text in "([0-9]{1,3}|[-+.eE,; \t\r\n\"#/xyzRGB]|nan|1e999){0,200}") {
        for ending in ["", "xyz", "pts", "obj", "ptx", "pcd"] {
            sound(text.as_bytes(), ending);
        }
    }

    #[test]
    fn random_bytes_do_no_harm(bytes in prop::collection::vec(any::<u8>(), 1..300)) {
        for ending in ["", "xyz", "obj", "ptx", "pcd", "ply"] {
            sound(&bytes, ending);
        }
    }
}

#[test]
fn columns_are_guessed_as_people_write_them() {
    let guess = |lines: &str| {
        let file = named(lines.as_bytes(), "txt");
        let scan = fmmgi_gpu::scan::Scan::read(file.path(), &Default::default(), &Silent).unwrap();
        scan.fields.join(" ")
    };
    for (lines, expected) in [
        ("0 0 0 1\n1 2 3 7\n", "x y z intensity"),
        // As PTS files: an intensity that could be a colour comes first.
        (
            "0 0 0 90 1 2 3\n1 2 3 80 99 0 0\n",
            "x y z intensity red green blue",
        ),
        (
            "0 0 0 1 2 3 255\n1 2 3 99 0 0 255\n",
            "x y z red green blue alpha",
        ),
        ("0 0 0 1.0 2.0 99.0\n", "x y z red green blue"),
        ("0 0 0 0.1 0.2 0.3\n1 2 3 0.5 1 0\n", "x y z red green blue"),
        ("0 0 0 0 0 1\n1 2 3 0.6 0.8 0\n", "x y z nx ny nz"),
        // Small whole numbers are classes, returns and the like.
        ("0 0 0 2 1 1\n1 2 3 5 0 3\n", "x y z intensity _ _"),
        (
            "0 0 0 512 wall 3\n1 2 3 600 floor 5\n",
            "x y z intensity _ _",
        ),
        // A label behind colours that are more alike; an intensity before them.
        (
            "0 .5 0 90 91 92 0\n1 2 3 80 80 84 1\n1 2 5 200 203 200 1\n",
            "x y z red green blue label",
        ),
        (
            "0 .5 0 9 91 92 90\n1 2 3 180 80 84 80\n1 2 5 20 203 200 200\n",
            "x y z intensity red green blue",
        ),
        (
            "0 .5 0 91 92 90 -7\n1 2 3 80 84 80 8\n1 2 5 203 200 200 900\n",
            "x y z red green blue label",
        ),
        (
            "0 .5 0 5120 6000 65535\n1 2 3 600 40000 5\n",
            "x y z red green blue",
        ),
        (
            "0 .5 0 90 3 91 92 90\n1 2 3 70 1 80 84 80\n1 2 5 99 2 203 200 200\n",
            "x y z intensity _ red green blue",
        ),
        (
            "9 99 9 0 .5 .25\n9 9 9 .5 1.5 2.5\n9 7 9 1.5 3 4.5\n",
            "red green blue x y z",
        ),
        // Row and column, a running number, a label before the place.
        (
            "0 0 .5 1 .25 9 99 9\n0 1 .5 2 .25 9 9 9\n1 0 .5 3 .25 9 9 9\n1 2 .5 .5 1 9 9 9\n",
            "row column x y z red green blue",
        ),
        (
            "0 0 .5 1 .25 9\n1 0 .5 2 .25 9\n2 0 .5 3 .25 9\n0 1 .5 .5 1 9\n",
            "row column x y z intensity",
        ),
        ("1 .5 1.5 7\n2 .5 2.5 8\n3 1.5 0 9.5\n", "_ x y z"),
        ("2 .5 1.5 7.5\n6 .5 2.5 8\n2 1.5 0 9.5\n", "label x y z"),
        // A place of whole numbers is one.
        ("0 0 5.25 9\n0 1 5.5 7\n1 0 6.25 3\n", "x y z intensity"),
        ("0 0 0 0 0 1\n0 1 0 0 0 1\n1 0 0 0 0 1\n", "x y z nx ny nz"),
    ] {
        assert_eq!(guess(lines), expected, "{lines}");
    }
    let fraction = read(b"0 0 0 0 0.5 1\n1 2 3 1 0 0\n").unwrap();
    let expected = Vec3::new(0.0, 0.214_041, 0.9);
    assert!((fraction.reflectance[0] - expected).length() < 1e-5);
}

#[test]
fn tables_of_other_programs_are_understood() {
    let cloud = read(
        b"\"Name, of it\",\"Easting (m)\",Northing,Elevation,Scalar_Emission_Red,\
          emission_green,emission_blue,reflectance.red,reflectance.green,reflectance.blue\n\
          \"a, b\",500000.125,1,2,3,4,5,.1,.2,.3\nc,7,8,,0,0,0,.5,.5,.5\n",
    )
    .unwrap();
    assert_eq!(cloud.positions[0], DVec3::new(500_000.125, 1.0, 2.0));
    assert!(cloud.positions[1].z.is_nan());
    assert_eq!(cloud.emission[0], Vec3::new(3.0, 4.0, 5.0));
    assert_eq!(cloud.reflectance[0], Vec3::new(0.1, 0.2, 0.3));
    // Lines that all end with a delimiter; 16-bit colours.
    let cloud = read(b"x;y;z;r;g;b;\n1;2;3;65535;0;48316;\n").unwrap();
    assert!((cloud.reflectance[0] - Vec3::new(0.9, 0.0, 0.502_886)).length() < 1e-4);
    // What Microsoft's runtime writes for no number.
    let cloud = read(b"1 2 3\n1.#QNAN -nan(ind) 3\n").unwrap();
    assert!(cloud.positions[1].x.is_nan());
}

#[test]
fn tables_are_understood_however_they_are_parted() {
    let places = [DVec3::new(0.25, 1.5, -2.0), DVec3::new(3.0, 4.25, 5.0)];
    for text in [
        "X;Y;Z;R;G;B\n0,25;1,5;-2;255;0;188\n3;4,25;5;0;0;0\n",
        "X\tY\tZ\tR\tG\tB\n0,25\t1,5\t-2\t255\t0\t188\n3\t4,25\t5\t0\t0\t0\n",
        "0,25 1,5 -2 255 0 188\n3 4,25 5 0 0 0\n",
        "# x,y,z,r,g,b\n0.25 1.5 -2 255 0 188\n3 4.25 5 0 0 0\n",
        "\"x\" \"y\" \"z\" \"red\" \"green\" \"blue\"\n\"1\" 0.25 1.5 -2 255 0 188\n\"2\" 3 4.25 5 0 0 0\n",
        "x y z red green blue\nfirst 0.25 1.5 -2 255 0 188\nlast 3 4.25 5 0 0 0\n",
        "Name\tX\tY\tZ\tRed (8 bit)\tG\tB\na b\t0.25\t1.5\t-2\t255\t0\t188\n\t3\t4.25\t5\t0\t0\t0\n",
    ] {
        let utf16 = |mark: bool, bytes: fn(u16) -> [u8; 2]| {
            let mark = mark.then_some(0xfeff);
            mark.into_iter()
                .chain(text.encode_utf16())
                .flat_map(bytes)
                .collect::<Vec<u8>>()
        };
        for bytes in [
            text.as_bytes().to_vec(),
            text.replace('\n', "\r\n").into_bytes(),
            utf16(true, u16::to_le_bytes),
            utf16(true, u16::to_be_bytes),
            utf16(false, u16::to_le_bytes),
        ] {
            let cloud = read(&bytes).unwrap_or_else(|error| panic!("{text}: {error}"));
            assert_eq!(cloud.positions, places, "{text}");
            let expected = Vec3::new(0.9, 0.0, 0.502_886);
            assert!((cloud.reflectance[0] - expected).length() < 1e-4, "{text}");
        }
    }
}

#[test]
fn columns_are_what_they_are_told_to_be() {
    let file = named(b"7 0 1 2 255 0 188\n8 1 1 2 0 0 0\n", "txt");
    let read = |columns: &str| {
        let options = ReadOptions {
            columns: columns.split(',').map(str::to_owned).collect(),
            ..ReadOptions::default()
        };
        Scan::read(file.path(), &options, &Silent)
    };
    let cloud = read("_,x,y,z,r,g,b").unwrap().cloud;
    assert_eq!(cloud.positions[0], DVec3::new(0.0, 1.0, 2.0));
    assert!((cloud.reflectance[0] - Vec3::new(0.9, 0.0, 0.502_886)).length() < 1e-4);
    let error = read("x,y,z").unwrap_err().to_string();
    assert!(
        error.contains("--columns names 3, and the lines have 7 values"),
        "{error}"
    );
}

/// Notes that reading leaves.
#[derive(Default)]
struct Notes(std::sync::Mutex<Vec<String>>);

impl fmmgi_gpu::Progress for Notes {
    fn note(&self, line: &str) {
        self.0.lock().unwrap().push(line.to_owned());
    }
}

#[test]
fn what_could_be_two_things_is_told() {
    for (text, both) in [
        (
            "0 0 0.5 90 91 92 93\n1 2 3 80 81 82 83\n",
            ["intensity red green blue", "red green blue label"],
        ),
        (
            "1 .5 1.5 7\n2 .5 2.5 8\n3 1.5 0 9.5\n",
            ["_ x y z", "x y z intensity"],
        ),
    ] {
        let notes = Notes::default();
        scan::read(named(text.as_bytes(), "txt").path(), &notes).unwrap();
        let notes = notes.0.into_inner().unwrap().concat();
        assert!(both.iter().all(|names| notes.contains(names)), "{notes}");
    }
}

#[test]
fn black_points_at_the_beginning_do_not_tell_the_depth() {
    let mut text = "x y z red green blue\n".to_owned();
    text += &"1.00000 2.00000 3.00000 0 0 0\n".repeat(200_000);
    text += "1 2 3 200 200 200\n";
    let cloud = read(text.as_bytes()).unwrap();
    assert!((cloud.reflectance[200_000].x - 0.577_58).abs() < 1e-4);
    // The same without names: the colours begin behind the first block.
    let text =
        text.split_once('\n').unwrap().1.to_owned() + &"1 2 3.5 200 200 200\n".repeat(300_000);
    let cloud = read(text.as_bytes()).unwrap();
    assert!((cloud.reflectance[200_000].x - 0.577_58).abs() < 1e-4);
}

#[test]
fn what_is_wrong_is_told() {
    let long = [b"1 2 3\n".to_vec(), vec![b'1'; 5 << 20]].concat();
    let cases: &[(&[u8], &str)] = &[
        (
            b"3\n1 2 3\n4 5 6\n",
            "cut short: it ends after 2 of 3 points",
        ),
        (
            b"99999999999999\n1 2 3\n",
            "it ends after 1 of 99999999999999 points",
        ),
        (b"7\n", "it ends after 0 of 7 points"),
        (b"1 2 3\n4 5\n", "line 2: 2 values; the first line has 3"),
        (
            b"1 2 3\n\n# x\n4 5 6 7\n",
            "line 4: more values than the 3 of the first line",
        ),
        (
            b"1 2 3\n4 5 six\n",
            "line 2: \"six\" is no number (column 3)",
        ),
        (b"a b c\n1 2 3\n", "\"a b c\", does not name x, y and z"),
        (b"1 2\n3 4\n", "\"1 2\" is no point"),
        (b"x y z\n", "no line of points"),
        (b"X,Y,Z\n0,25,0,5,0,0\n", "if the commas are decimal ones"),
        (b"\x1f\x8b\x08\0\0", "is compressed (gzip): unpack it first"),
        (b"\xff\xfep\0l\0y\0\n\0", "is text in UTF-16"),
        (&long, "line 2 is longer than"),
    ];
    for (bytes, expected) in cases {
        let message = error_named(bytes, "xyz");
        assert!(message.contains(expected), "{message:?} lacks {expected:?}");
    }
    let cut = read(b"1 2 3\n4 5 6").unwrap();
    assert!(cut.repairs[0].contains("the last line has no end"));
    let more = read(b"1\n1 2 3\n4 5 6\n").unwrap();
    assert_eq!(
        more.repairs,
        ["1 points beyond the count of the file taken too"]
    );
}

#[test]
fn the_content_goes_before_the_name() {
    let ply = two_points("", "", "");
    for ending in ["xyz", "pcd", "las", "obj"] {
        let file = named(&ply, ending);
        assert_eq!(scan::read(file.path(), &Silent).unwrap().len(), 2);
    }
    // Without a mark in the content the name decides which reader tells what is wrong.
    for (ending, expected) in [
        ("pcd", "header line 1 (\"1 2 3\"): not understood"),
        ("ply", "a PLY file begins with a line \"ply\""),
        (
            "ptx",
            "line 1: \"1 2 3\" is no number (columns or rows of a grid)",
        ),
        ("obj", "the file has no vertices"),
    ] {
        let message = error_named(b"1 2 3\n", ending);
        assert!(message.contains(expected), "{message:?} lacks {expected:?}");
        assert!(
            message.contains("its content is a table of points"),
            "{message:?}"
        );
    }
    for (bytes, ending) in [
        (&b"\x7fELF\x02\x01\0\0"[..], ""),
        (b"# Title\nSome words.\n", "md"),
    ] {
        let message = error_named(bytes, ending);
        assert!(
            message.contains("LAZ, E57, PCD, PTX, PTS, OBJ, or text"),
            "{message}"
        );
    }
}

#[test]
fn blocks_join_without_a_seam() {
    // Several blocks of 4 MiB, whose ends fall inside lines.
    let n = 400_000;
    let text: String = (0..n).map(|i| format!("{i} {}.5 -{i}\n", 2 * i)).collect();
    let cloud = read(text.as_bytes()).unwrap();
    let place = |i: u32| DVec3::new(i.into(), f64::from(2 * i) + 0.5, -f64::from(i));
    assert!(cloud.positions.iter().copied().eq((0..n).map(place)));
    let broken = text.replace("\n350000 ", "\nx ");
    assert!(error_named(broken.as_bytes(), "xyz").contains("line 350001: \"x\" is no number"));
}
