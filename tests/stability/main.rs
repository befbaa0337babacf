//! Where methods break: each case is lit by every method, and holds or says so. What was found is in
//! `docs/stability.md`, which the ignored test `page` writes.

#[path = "../clouds/mod.rs"]
mod clouds;
#[path = "../common/mod.rs"]
mod common;
#[path = "../rooms/mod.rs"]
mod rooms;

mod harness;
mod lights;
mod normals;
mod operators;
mod page;
mod places;
mod scenes;
mod surfaces;

use harness::{Case, Outcome, run};
use page::Section;

const SECTIONS: [Section; 14] = [
    Section {
        title: "Coincident and nearly coincident points",
        text: "A room whose points are there twice, against the light of the room with each point once.",
        cases: places::coincident,
    },
    Section {
        title: "Buried layers",
        text: "A second layer of points behind the first, as two scans that do not fit make it, against the \
               light of the room without it.",
        cases: places::buried,
    },
    Section {
        title: "Edges",
        text: "Against exact sums.",
        cases: places::edges,
    },
    Section {
        title: "Thin walls",
        text: "A lit room and a dark one behind a wall, against the lit room alone and no light in the other.",
        cases: surfaces::walls,
    },
    Section {
        title: "Plates closing",
        text: "A black plate and a shining one, against the closed form.",
        cases: surfaces::plates,
    },
    Section {
        title: "Grazing receivers",
        text: "Two leaves of a book, one of which shines, against the closed form.",
        cases: surfaces::books,
    },
    Section {
        title: "In a plane, on a line, in one place",
        text: "Against what is known: no light from a plane to itself, all of the sky.",
        cases: places::degenerate,
    },
    Section {
        title: "Density",
        text: "A patch of the floor is denser than the rest of floor and ceiling; closed forms.",
        cases: places::dense,
    },
    Section {
        title: "Units, places, orders",
        text: "Against the light of the room as it was.",
        cases: places::units,
    },
    Section {
        title: "White rooms",
        text: "The furnace, which shines with what it does not reflect, has an irradiance of 1; others against \
               exact sums.",
        cases: lights::white,
    },
    Section {
        title: "Lamps",
        text: "Against exact sums.",
        cases: lights::emission,
    },
    Section {
        title: "Point lights",
        text: "Against exact sums.",
        cases: lights::lights,
    },
    Section {
        title: "Areas",
        text: "Areas that the file gives, against exact sums with them.",
        cases: lights::areas,
    },
    Section {
        title: "Normals, noise, outliers",
        text: "Against exact sums over the same points, if nothing else is said.",
        cases: || {
            [normals::normals(), normals::noise(), places::outliers()]
                .into_iter()
                .flatten()
                .collect()
        },
    },
];

/// The cases of a section with what came of them, and what came out otherwise than expected.
fn lit(section: &Section) -> (Vec<(Case, Vec<Outcome>)>, Vec<String>) {
    let cases = (section.cases)().into_iter();
    let lit: Vec<_> = cases
        .map(|case| {
            let outcomes = run(&case);
            for outcome in &outcomes {
                println!("{}", outcome.line(&case));
            }
            (case, outcomes)
        })
        .collect();
    let complaint = |(case, outcomes): &(Case, Vec<Outcome>)| -> Vec<String> {
        outcomes.iter().filter_map(|o| o.complaint(case)).collect()
    };
    let complaints = lit.iter().flat_map(complaint).collect();
    (lit, complaints)
}

/// Lights all cases, prints what came out, writes the page.
#[test]
#[ignore = "writes docs/stability.md"]
fn page() {
    let mut page = page::head();
    let mut complaints = Vec::new();
    for section in &SECTIONS {
        let (lit, others) = lit(section);
        page.push_str(&page::table(section, &lit));
        complaints.extend(others);
    }
    page.push_str(&operators::table());
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/stability.md");
    std::fs::write(path, page).expect("written");
    assert!(complaints.is_empty(), "{complaints:#?}");
}

fn holds_or_says_so(section: usize) {
    let (_, complaints) = lit(&SECTIONS[section]);
    assert!(complaints.is_empty(), "{complaints:#?}");
}

#[test]
fn coincident_points() {
    holds_or_says_so(0);
}

#[test]
fn buried_layers() {
    holds_or_says_so(1);
}

#[test]
fn edges() {
    holds_or_says_so(2);
}

#[test]
fn thin_walls() {
    holds_or_says_so(3);
}

#[test]
fn plates_closing() {
    holds_or_says_so(4);
}

#[test]
fn grazing_receivers() {
    holds_or_says_so(5);
}

#[test]
fn degenerate_clouds() {
    holds_or_says_so(6);
}

#[test]
fn density_steps() {
    holds_or_says_so(7);
}

#[test]
fn units_places_orders() {
    holds_or_says_so(8);
}

#[test]
fn white_rooms() {
    holds_or_says_so(9);
}

#[test]
fn lamps() {
    holds_or_says_so(10);
}

#[test]
fn point_lights() {
    holds_or_says_so(11);
}

#[test]
fn areas() {
    holds_or_says_so(12);
}

#[test]
fn normals_noise_outliers() {
    holds_or_says_so(13);
}
