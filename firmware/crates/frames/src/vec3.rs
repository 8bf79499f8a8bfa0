use core::marker::PhantomData;
use core::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

use nalgebra::{Matrix3, Vector3};

use crate::{Frame, Real, math};

/// A 3-vector resolved in frame `F`.
///
/// Units are those of the quantity and are stated where it is named.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vec3<F: Frame, T: Real = f32> {
    v: Vector3<T>,
    frame: PhantomData<F>,
}

impl<F: Frame, T: Real> Vec3<F, T> {
    /// The vector (x, y, z).
    #[inline]
    pub fn new(x: T, y: T, z: T) -> Self {
        Self::from_vector(Vector3::new(x, y, z))
    }

    /// A bare vector; the caller asserts that it is resolved in `F`.
    #[inline]
    pub fn from_vector(v: Vector3<T>) -> Self {
        Self { v, frame: PhantomData }
    }

    /// The zero vector.
    #[inline]
    pub fn zero() -> Self {
        Self::from_vector(Vector3::zeros())
    }

    /// The x component.
    #[inline]
    pub fn x(&self) -> T {
        self.v.x
    }

    /// The y component.
    #[inline]
    pub fn y(&self) -> T {
        self.v.y
    }

    /// The z component.
    #[inline]
    pub fn z(&self) -> T {
        self.v.z
    }

    /// The components without their frame, for linear algebra.
    #[inline]
    pub fn vector(&self) -> Vector3<T> {
        self.v
    }

    /// The components as an array, for output.
    #[inline]
    pub fn to_array(&self) -> [T; 3] {
        self.v.into()
    }

    /// The cross product `self × other`.
    #[inline]
    pub fn cross(self, other: Self) -> Self {
        Self::from_vector(self.v.cross(&other.v))
    }

    /// The inner product.
    #[inline]
    pub fn dot(self, other: Self) -> T {
        self.v.dot(&other.v)
    }

    /// The Euclidean norm.
    #[inline]
    pub fn norm(self) -> T {
        math::sqrt(self.dot(self))
    }

    /// The matrix `[v×]` with `[v×] u = v × u`.
    #[inline]
    pub fn skew(self) -> Matrix3<T> {
        self.v.cross_matrix()
    }

    /// Whether every component is finite.
    #[inline]
    pub fn is_finite(self) -> bool {
        self.v.iter().all(|c| c.finite())
    }

    /// The same vector in another precision.
    #[inline]
    pub fn cast<U: Real>(self) -> Vec3<F, U> {
        Vec3::from_vector(self.v.map(|c| U::lit(c.to_f64())))
    }
}

impl<F: Frame, T: Real> Add for Vec3<F, T> {
    type Output = Self;
    #[inline]
    fn add(self, other: Self) -> Self {
        Self::from_vector(self.v + other.v)
    }
}

impl<F: Frame, T: Real> AddAssign for Vec3<F, T> {
    #[inline]
    fn add_assign(&mut self, other: Self) {
        self.v += other.v;
    }
}

impl<F: Frame, T: Real> Sub for Vec3<F, T> {
    type Output = Self;
    #[inline]
    fn sub(self, other: Self) -> Self {
        Self::from_vector(self.v - other.v)
    }
}

impl<F: Frame, T: Real> SubAssign for Vec3<F, T> {
    #[inline]
    fn sub_assign(&mut self, other: Self) {
        self.v -= other.v;
    }
}

impl<F: Frame, T: Real> Neg for Vec3<F, T> {
    type Output = Self;
    #[inline]
    fn neg(self) -> Self {
        Self::from_vector(-self.v)
    }
}

impl<F: Frame, T: Real> Mul<T> for Vec3<F, T> {
    type Output = Self;
    #[inline]
    fn mul(self, factor: T) -> Self {
        Self::from_vector(self.v * factor)
    }
}

impl<F: Frame, T: Real> Div<T> for Vec3<F, T> {
    type Output = Self;
    #[inline]
    fn div(self, divisor: T) -> Self {
        Self::from_vector(self.v / divisor)
    }
}
