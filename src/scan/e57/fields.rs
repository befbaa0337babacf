//! What the values of an E57 point mean.

use e57::{PointCloud, Record, RecordDataType, RecordName, RecordValue};
use glam::{DQuat, DVec3, Vec3};

use crate::points::{DEFAULT_REFLECTANCE, Grid, MAX_COLOUR_REFLECTANCE};
use crate::scan::colours::Stored;
use crate::scan::names;

/// A field, and how its stored values are to be read.
#[derive(Clone, Copy)]
struct Field {
    index: usize,
    scale: f64,
    offset: f64,
}

/// Fields whose values count only where a state, if there is one, is 0.
struct Checked<const N: usize> {
    fields: [Field; N],
    state: Option<Field>,
}

/// Where the values of a scan's points have what.
pub struct Fields {
    cartesian: Option<Checked<3>>,
    /// Range, azimuth, elevation.
    spherical: Option<Checked<3>>,
    normal: Option<Checked<3>>,
    colour: Option<(Checked<3>, Shades)>,
    intensity: Option<(Checked<1>, Span)>,
}

/// The values from black to white.
#[derive(Clone, Copy, PartialEq)]
pub struct Span {
    pub min: f64,
    pub max: f64,
}

/// How the colours of a scan are stored, and their limits, if they have any.
#[derive(Clone, Copy, PartialEq)]
pub struct Shades {
    pub stored: Stored,
    pub limits: Option<[Span; 3]>,
}

impl Fields {
    pub fn find(scan: &PointCloud) -> Self {
        use RecordName as Name;
        let one = |name: &Name| Field::find(&scan.prototype, name);
        let checked = |names: [Name; 3], state: Name| {
            let [a, b, c] = names.map(|name| one(&name));
            Some(Checked {
                fields: [a?, b?, c?],
                state: one(&state),
            })
        };
        // Of extensions, by whatever name they have.
        let others: Vec<&str> = (scan.prototype.iter())
            .map(|record| match &record.name {
                Name::Unknown { name, .. } => name.as_str(),
                _ => "",
            })
            .collect();
        let normal =
            ["nx", "ny", "nz"].map(|axis| one(&scan.prototype[names::find(&others, axis)?].name));
        let limits = scan.color_limits.as_ref();
        let spans = [
            (Name::ColorRed, limits.map(|l| (&l.red_min, &l.red_max))),
            (
                Name::ColorGreen,
                limits.map(|l| (&l.green_min, &l.green_max)),
            ),
            (Name::ColorBlue, limits.map(|l| (&l.blue_min, &l.blue_max))),
        ]
        .map(|(name, limits)| Span::of(&scan.prototype, &name, limits));
        let colours = checked(
            [Name::ColorRed, Name::ColorGreen, Name::ColorBlue],
            Name::IsColorInvalid,
        );
        let colour = colours.map(|fields| {
            let [red, ..] = &fields.fields;
            let shades = Shades {
                stored: stored(&scan.prototype[red.index].data_type),
                limits: match spans {
                    [Some(r), Some(g), Some(b)] => Some([r, g, b]),
                    _ => None,
                },
            };
            (fields, shades)
        });
        let limits = scan.intensity_limits.as_ref();
        let span = Span::of(
            &scan.prototype,
            &Name::Intensity,
            limits.map(|l| (&l.intensity_min, &l.intensity_max)),
        );
        let intensity = one(&Name::Intensity).zip(span).map(|(field, span)| {
            let fields = Checked {
                fields: [field],
                state: one(&Name::IsIntensityInvalid),
            };
            (fields, span)
        });
        Fields {
            cartesian: checked(
                [Name::CartesianX, Name::CartesianY, Name::CartesianZ],
                Name::CartesianInvalidState,
            ),
            spherical: checked(
                [
                    Name::SphericalRange,
                    Name::SphericalAzimuth,
                    Name::SphericalElevation,
                ],
                Name::SphericalInvalidState,
            ),
            normal: match normal {
                [Some(x), Some(y), Some(z)] => Some(Checked {
                    fields: [x, y, z],
                    state: None,
                }),
                _ => None,
            },
            intensity: intensity.filter(|_| colour.is_none()),
            colour,
        }
    }

    pub fn has_coordinates(&self) -> bool {
        self.cartesian.is_some() || self.spherical.is_some()
    }

    pub fn has_normals(&self) -> bool {
        self.normal.is_some()
    }

    pub fn is_spherical(&self) -> bool {
        self.cartesian.is_none() && self.spherical.is_some()
    }

    /// Number of points to which intensity gives a grey.
    pub fn is_grey(&self) -> bool {
        self.intensity.is_some()
    }

    /// In the coordinates of the scanner; `None` where it got no answer.
    pub fn position(&self, values: &[RecordValue]) -> Option<DVec3> {
        let cartesian = self.cartesian.as_ref().and_then(|c| c.values(values));
        cartesian.map(DVec3::from).or_else(|| {
            let [range, azimuth, elevation] = self.spherical.as_ref()?.values(values)?;
            let (sin, cos) = elevation.sin_cos();
            let direction = DVec3::new(cos * azimuth.cos(), cos * azimuth.sin(), sin);
            (range > 0.0).then_some(range * direction)
        })
    }

    /// In the coordinates of the scanner.
    pub fn normal(&self, values: &[RecordValue]) -> Option<Vec3> {
        let normal = self.normal.as_ref()?.values(values)?;
        Some(DVec3::from(normal).as_vec3())
    }

    /// How colours are stored, if there are any.
    pub fn shades(&self) -> Option<Shades> {
        self.colour.as_ref().map(|(_, shades)| *shades)
    }

    /// The colour as it is stored, no number where it is invalid; where the scan has none, a reflectance:
    /// intensity is a linear grey.
    pub fn colour(&self, values: &[RecordValue]) -> Vec3 {
        if let Some((fields, _)) = &self.colour {
            let stored = fields.values(values).map(DVec3::from);
            return stored.map_or(Vec3::NAN, |colour| colour.as_vec3());
        }
        let grey = self.intensity.as_ref().and_then(|(field, span)| {
            let grey = span.place(field.values(values)?[0]);
            Some(Vec3::splat(grey.min(MAX_COLOUR_REFLECTANCE)))
        });
        grey.unwrap_or(Vec3::splat(DEFAULT_REFLECTANCE))
    }

    /// The grid of coordinates that are scaled integers.
    pub fn grid(&self) -> Option<Grid> {
        let fields = self.cartesian.as_ref()?.fields;
        let grid = Grid {
            scale: DVec3::from(fields.map(|field| field.scale)),
            offset: DVec3::from(fields.map(|field| field.offset)),
            reference: Vec::new(),
        };
        let scaled = |scale: f64| scale != 0.0 && scale != 1.0 && scale.is_finite();
        let all = grid.scale.to_array().into_iter().all(scaled) && grid.offset.is_finite();
        all.then_some(grid)
    }
}

impl<const N: usize> Checked<N> {
    fn values(&self, values: &[RecordValue]) -> Option<[f64; N]> {
        let good = self.state.is_none_or(|state| state.value(values) == 0.0);
        good.then(|| self.fields.map(|field| field.value(values)))
    }
}

impl Field {
    fn find(prototype: &[Record], name: &RecordName) -> Option<Self> {
        let index = prototype.iter().position(|record| record.name == *name)?;
        let (scale, offset) = match prototype[index].data_type {
            RecordDataType::ScaledInteger { scale, offset, .. } => (scale, offset),
            _ => (1.0, 0.0),
        };
        Some(Field {
            index,
            scale,
            offset,
        })
    }

    #[inline]
    fn value(&self, values: &[RecordValue]) -> f64 {
        match values[self.index] {
            RecordValue::Single(value) => value.into(),
            RecordValue::Double(value) => value,
            RecordValue::Integer(value) | RecordValue::ScaledInteger(value) => {
                value as f64 * self.scale + self.offset
            }
        }
    }
}

impl Span {
    /// The limits that are given, or else those of the type; `None` if there are none.
    fn of(
        prototype: &[Record],
        name: &RecordName,
        limits: Option<(&Option<RecordValue>, &Option<RecordValue>)>,
    ) -> Option<Self> {
        let field = Field::find(prototype, name)?;
        let record = &prototype[field.index];
        let number = |value: &RecordValue| value.to_f64(&record.data_type).ok();
        let given =
            limits.and_then(|(min, max)| Some((number(min.as_ref()?)?, number(max.as_ref()?)?)));
        let of_type = || match record.data_type {
            RecordDataType::Single { min, max } => Some((min?.into(), max?.into())),
            RecordDataType::Double { min, max } => Some((min?, max?)),
            RecordDataType::Integer { min, max } => Some((min as f64, max as f64)),
            RecordDataType::ScaledInteger { min, max, .. } => {
                let value = |integer| integer as f64 * field.scale + field.offset;
                Some((value(min), value(max)))
            }
        };
        // All that 64 bit hold is what is said where nothing is said.
        let usable = |&(min, max): &(f64, f64)| max > min && max - min < 2f64.powi(63);
        let (min, max) = given.filter(usable).or_else(of_type).filter(usable)?;
        Some(Span { min, max })
    }

    /// Where in the span a value is, from 0 to 1.
    pub fn place(&self, value: f64) -> f32 {
        let place = ((value - self.min) / (self.max - self.min)) as f32;
        if place.is_nan() {
            0.5
        } else {
            place.clamp(0.0, 1.0)
        }
    }
}

/// How a field of this type holds a colour.
fn stored(kind: &RecordDataType) -> Stored {
    match kind {
        RecordDataType::Integer {
            min: 0..,
            max: ..=255,
        } => Stored::Bytes,
        RecordDataType::Integer { .. } => Stored::Whole,
        _ => Stored::Floats,
    }
}

/// From the coordinates of a scanner to those of the file; `None` if that is no rotation.
/// A quaternion of zeros is none, which is told.
pub fn pose(scan: &PointCloud, repairs: &mut Vec<String>) -> Option<(DQuat, DVec3)> {
    let Some(pose) = &scan.transform else {
        return Some((DQuat::IDENTITY, DVec3::ZERO));
    };
    let (q, t) = (&pose.rotation, &pose.translation);
    let mut turn = DQuat::from_xyzw(q.x, q.y, q.z, q.w);
    if turn.length_squared() == 0.0 {
        repairs.push("1 pose whose rotation is all zeros: taken as not turned".to_owned());
        turn = DQuat::IDENTITY;
    }
    let place = DVec3::new(t.x, t.y, t.z);
    let turns = turn.length_squared() > 0.0 && turn.length_squared().is_finite();
    (turns && place.is_finite()).then(|| (turn.normalize(), place))
}

/// The name of a field in the file.
pub fn name(record: &Record) -> String {
    match &record.name {
        RecordName::Unknown { namespace, name } => format!("{namespace}:{name}"),
        // The crate's names are those of the standard, but for the capital.
        name => {
            let mut name = format!("{name:?}");
            name[..1].make_ascii_lowercase();
            name
        }
    }
}
