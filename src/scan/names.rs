//! What the names of columns mean: one table for all formats.
//!
//! Letters and digits alone count, without regard to case; units in brackets and the prefix `scalar_`
//! of CloudCompare are left off.

/// Each meaning with the names that it goes by, the best first.
const NAMES: [(&str, &[&str]); 31] = [
    (
        "x",
        &[
            "x",
            "easting",
            "east",
            "coordx",
            "xcoord",
            "posx",
            "positionx",
            "pointx",
            "points0",
            "longitude",
            "lon",
        ],
    ),
    (
        "y",
        &[
            "y",
            "northing",
            "north",
            "coordy",
            "ycoord",
            "posy",
            "positiony",
            "pointy",
            "points1",
            "latitude",
            "lat",
        ],
    ),
    (
        "z",
        &[
            "z",
            "height",
            "elevation",
            "altitude",
            "coordz",
            "zcoord",
            "posz",
            "positionz",
            "pointz",
            "points2",
        ],
    ),
    (
        "nx",
        &["nx", "normalx", "normalsx", "normx", "norx", "normals0"],
    ),
    (
        "ny",
        &["ny", "normaly", "normalsy", "normy", "nory", "normals1"],
    ),
    (
        "nz",
        &["nz", "normalz", "normalsz", "normz", "norz", "normals2"],
    ),
    (
        "red",
        &[
            "red",
            "r",
            "diffusered",
            "rgb0",
            "colors0",
            "colorred",
            "colourred",
            "colorr",
            "colourr",
            "rf",
        ],
    ),
    (
        "green",
        &[
            "green",
            "g",
            "diffusegreen",
            "rgb1",
            "colors1",
            "colorgreen",
            "colourgreen",
            "colorg",
            "colourg",
            "gf",
        ],
    ),
    (
        "blue",
        &[
            "blue",
            "b",
            "diffuseblue",
            "rgb2",
            "colors2",
            "colorblue",
            "colourblue",
            "colorb",
            "colourb",
            "bf",
        ],
    ),
    ("original_red", &["originalred"]),
    ("original_green", &["originalgreen"]),
    ("original_blue", &["originalblue"]),
    ("rgb", &["rgb", "rgba"]),
    ("f_dc_0", &["fdc0"]),
    ("f_dc_1", &["fdc1"]),
    ("f_dc_2", &["fdc2"]),
    ("reflectance_red", &["reflectancered"]),
    ("reflectance_green", &["reflectancegreen"]),
    ("reflectance_blue", &["reflectanceblue"]),
    ("emission_red", &["emissionred"]),
    ("emission_green", &["emissiongreen"]),
    ("emission_blue", &["emissionblue"]),
    ("area", &["area"]),
    ("radius", &["radius"]),
    ("reflectance", &["reflectance", "albedo"]),
    ("intensity", &["intensity", "i", "amplitude", "remission"]),
    (
        "label",
        &["label", "class", "classification", "segment", "cluster"],
    ),
    ("row", &["row", "rowindex"]),
    ("column", &["column", "columnindex", "col"]),
    ("alpha", &["alpha", "a", "diffusealpha"]),
    ("time", &["time", "gpstime", "timestamp"]),
];

/// The column with a meaning, if there is one: the best of its names, literally if possible.
pub fn find<S: AsRef<str>>(columns: &[S], meaning: &str) -> Option<usize> {
    let place = |is: &dyn Fn(&str) -> bool| columns.iter().position(|name| is(name.as_ref()));
    let (_, names) = NAMES.iter().find(|(of, _)| *of == meaning)?;
    place(&|name| name == meaning).or_else(|| {
        let mut names = names.iter();
        names.find_map(|&known| place(&|name| plain(name) == known))
    })
}

/// What a name means, if that is known.
pub fn meaning(name: &str) -> Option<&'static str> {
    let plain = plain(name);
    let known = NAMES.iter().find(|(_, names)| names.contains(&&*plain));
    known.map(|(meaning, _)| *meaning)
}

/// Letters and digits of a name, small, without unit and prefix.
fn plain(name: &str) -> String {
    let name = name.to_lowercase();
    let name = name.strip_prefix("scalar_").unwrap_or(&name);
    let name = name.split(['(', '[']).next().unwrap_or_default();
    name.chars().filter(|c| c.is_alphanumeric()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_known_however_they_are_written() {
        for (name, expected) in [
            ("X", Some("x")),
            ("\"Easting (m)\"", Some("x")),
            ("Coord. Z", Some("z")),
            ("Points:1", Some("y")),
            ("NormalX", Some("nx")),
            ("normal_y", Some("ny")),
            ("scalar_Nz", Some("nz")),
            ("diffuse_red", Some("red")),
            ("Rf", Some("red")),
            ("f_dc_2", Some("f_dc_2")),
            ("Reflectance.Red", Some("reflectance_red")),
            ("Scalar_Intensity", Some("intensity")),
            ("", None),
            ("irradiance_r", None),
        ] {
            assert_eq!(meaning(name), expected, "{name}");
        }
        // Of two the better, and the literal one.
        assert_eq!(find(&["Rf", "R", "red"], "red"), Some(2));
        assert_eq!(find(&["Rf", "R"], "red"), Some(1));
        assert_eq!(find(&["scalar_X", "x"], "x"), Some(1));
        assert_eq!(find(&["u", "v"], "x"), None);
    }
}
