//! Real numbers and vectors of the CPU passes, which are generic: f64 is the reference, f32 the
//! product.

use std::fmt::Debug;
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

use glam::{DVec3, Vec3, Vec3A};

/// A real, or some of which each goes its own way.
pub trait Numbers<T>:
    Copy + Default + Add<Output = Self> + AddAssign + Mul<T, Output = Self> + Mul<Self, Output = Self>
{
    fn splat(x: T) -> Self;
}

/// Light of a point: red, green and blue, or one number where all is grey.
pub trait Colour<T>: Numbers<T> + Debug + Send + Sync + 'static + PartialEq {
    /// What it is where much is calculated with it: red, green and blue of f32 are one SIMD register.
    type Wide: Colour<T> + From<Self> + Into<Self>;
    const CHANNELS: usize;
    /// Of grey the first.
    fn from_rgb(rgb: [T; 3]) -> Self;
    /// Of grey all alike.
    fn to_rgb(self) -> [T; 3];
}

/// Whether red, green and blue are the same.
pub(crate) fn is_grey<T: PartialEq>([r, g, b]: [T; 3]) -> bool {
    r == g && g == b
}

/// A vector of three reals: a place, a direction, or red, green and blue.
pub trait Vector<T>:
    Numbers<T>
    + Debug
    + Send
    + Sync
    + 'static
    + PartialEq
    + Sub<Output = Self>
    + SubAssign
    + Neg<Output = Self>
{
    /// From storage, which is f32 for both reals.
    fn from_f32(v: Vec3) -> Self;
    fn to_f32(self) -> Vec3;
    fn dot(self, other: Self) -> T;
    fn cross(self, other: Self) -> Self;
    fn length(self) -> T;
    fn to_array(self) -> [T; 3];
}

/// A real number: f32 or f64.
pub trait Real:
    Colour<Self, Wide = Self>
    + PartialOrd
    + Sub<Output = Self>
    + SubAssign
    + Div<Output = Self>
    + Neg<Output = Self>
    + Sum
{
    type Vec3: Vector<Self> + Colour<Self, Wide = Self::Rgb>;
    /// Red, green and blue where much is calculated with them: one SIMD register for f32.
    type Rgb: Colour<Self>;
    const ZERO: Self;
    const ONE: Self;
    /// Distance from 1 to the next number.
    const EPSILON: f64;
    const PI: Self;
    fn from_f64(x: f64) -> Self;
    fn from_f32(x: f32) -> Self;
    fn to_f64(self) -> f64;
    fn abs(self) -> Self;
    fn sqrt(self) -> Self;
    /// self · a + b, rounded once: slow on machines without the instruction.
    fn mul_add(self, a: Self, b: Self) -> Self;
    fn atan2(self, x: Self) -> Self;
    fn min(self, other: Self) -> Self;
    fn max(self, other: Self) -> Self;
}

macro_rules! vector {
    ($t:ty, $v:ty, $wide:ty, $from:expr, $to:expr) => {
        impl Numbers<$t> for $v {
            #[inline(always)]
            fn splat(x: $t) -> Self {
                <$v>::splat(x)
            }
        }

        impl Colour<$t> for $v {
            type Wide = $wide;
            const CHANNELS: usize = 3;
            #[inline(always)]
            fn from_rgb(rgb: [$t; 3]) -> Self {
                <$v>::from_array(rgb)
            }
            #[inline(always)]
            fn to_rgb(self) -> [$t; 3] {
                <$v>::to_array(&self)
            }
        }

        impl Vector<$t> for $v {
            #[inline(always)]
            fn from_f32(v: Vec3) -> Self {
                $from(v)
            }
            #[inline(always)]
            fn to_f32(self) -> Vec3 {
                $to(self)
            }
            #[inline(always)]
            fn dot(self, other: Self) -> $t {
                <$v>::dot(self, other)
            }
            #[inline(always)]
            fn cross(self, other: Self) -> Self {
                <$v>::cross(self, other)
            }
            #[inline(always)]
            fn length(self) -> $t {
                <$v>::length(self)
            }
            #[inline(always)]
            fn to_array(self) -> [$t; 3] {
                <$v>::to_array(&self)
            }
        }
    };
}

vector!(f32, Vec3, Vec3A, |v: Vec3| v, |v: Vec3| v);
vector!(f32, Vec3A, Vec3A, Vec3A::from, Vec3::from);
vector!(f64, DVec3, DVec3, DVec3::from, |v: DVec3| v.as_vec3());

macro_rules! real {
    ($t:ty, $v:ty, $rgb:ty, $pi:expr) => {
        impl Numbers<$t> for $t {
            #[inline(always)]
            fn splat(x: $t) -> Self {
                x
            }
        }

        impl Colour<$t> for $t {
            type Wide = $t;
            const CHANNELS: usize = 1;
            #[inline(always)]
            fn from_rgb([grey, ..]: [$t; 3]) -> Self {
                grey
            }
            #[inline(always)]
            fn to_rgb(self) -> [$t; 3] {
                [self; 3]
            }
        }

        impl Real for $t {
            type Vec3 = $v;
            type Rgb = $rgb;
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;
            const EPSILON: f64 = <$t>::EPSILON as f64;
            const PI: Self = $pi;
            #[inline(always)]
            fn from_f64(x: f64) -> Self {
                x as $t
            }
            #[inline(always)]
            fn from_f32(x: f32) -> Self {
                x as $t
            }
            #[inline(always)]
            fn to_f64(self) -> f64 {
                self as f64
            }
            #[inline(always)]
            fn abs(self) -> Self {
                <$t>::abs(self)
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                <$t>::sqrt(self)
            }
            #[inline(always)]
            fn mul_add(self, a: Self, b: Self) -> Self {
                <$t>::mul_add(self, a, b)
            }
            #[inline(always)]
            fn atan2(self, x: Self) -> Self {
                <$t>::atan2(self, x)
            }
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                <$t>::min(self, other)
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                <$t>::max(self, other)
            }
        }
    };
}

real!(f32, Vec3, Vec3A, std::f32::consts::PI);
real!(f64, DVec3, DVec3, std::f64::consts::PI);
