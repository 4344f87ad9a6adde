//! The contract of REST: the bodies of requests and answers, apart from what the service computes
//! with and stores, so that neither changes with the other.
//!
//! A body of an answer says after its declaration what it is made from ([`Answer`]), a body of a
//! request what it asks for ([`Request`]). Both list every field: one that is added below and not
//! here does not compile. The doc comments are the descriptions in the OpenAPI document.

/// What an answer is made from: a struct field by field, an enum variant by variant.
macro_rules! answer {
    ($Domain:ty => $Wire:ident { $($field:ident),* $(,)? }) => {
        impl $crate::api::wire::Answer for $Domain {
            type Wire = $Wire;
            fn wire(self) -> $Wire {
                let Self { $($field),* } = self;
                $Wire { $($field: $crate::api::wire::Answer::wire($field)),* }
            }
        }
    };
    ($Domain:ty => enum $Wire:ident {
        $($Variant:ident $(($value:ident))? $({ $($field:ident),* })?),* $(,)?
    }) => {
        impl $crate::api::wire::Answer for $Domain {
            type Wire = $Wire;
            fn wire(self) -> $Wire {
                match self {
                    $(Self::$Variant $(($value))? $({ $($field),* })? => {
                        $Wire::$Variant $(($crate::api::wire::Answer::wire($value)))? $({
                            $($field: $crate::api::wire::Answer::wire($field)),*
                        })?
                    })*
                }
            }
        }
    };
}

/// What a request asks for: a struct field by field, an enum variant by variant.
macro_rules! request {
    ($Wire:ident => $Domain:ty { $($field:ident),* $(,)? }) => {
        impl $crate::api::wire::Request for $Wire {
            type Means = $Domain;
            fn means(self) -> $Domain {
                type Domain = $Domain;
                let Self { $($field),* } = self;
                Domain { $($field: $crate::api::wire::Request::means($field)),* }
            }
        }
    };
    (enum $Wire:ident => $Domain:ty {
        $($Variant:ident $(($value:ident))? $({ $($field:ident),* })?),* $(,)?
    }) => {
        impl $crate::api::wire::Request for $Wire {
            type Means = $Domain;
            fn means(self) -> $Domain {
                type Domain = $Domain;
                match self {
                    $(Self::$Variant $(($value))? $({ $($field),* })? => {
                        Domain::$Variant $(($crate::api::wire::Request::means($value)))? $({
                            $($field: $crate::api::wire::Request::means($field)),*
                        })?
                    })*
                }
            }
        }
    };
}

mod audit;
mod bench;
mod calibration;
mod card;
mod dose_list;
mod evaluation;
mod film;
mod investigation;
mod job;
mod label;
mod parameter;
mod powder;
mod report;
mod repose;
mod shake;
mod simulator;
mod token;
mod training;
mod unit;
mod vial;
mod webhook;
mod weighing;

pub use audit::*;
pub use bench::*;
pub use calibration::*;
pub use card::*;
pub use dose_list::*;
pub use evaluation::*;
pub use film::*;
pub use investigation::*;
pub use job::*;
pub use label::*;
pub use parameter::*;
pub use powder::*;
pub use report::*;
pub use repose::*;
pub use shake::*;
pub use simulator::*;
pub use token::*;
pub use training::*;
pub use unit::*;
pub use vial::*;
pub use webhook::*;
pub use weighing::*;

use crate::app;
use flip_core::domain;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// Can be sent in an answer.
pub trait Answer {
    /// As it is sent.
    type Wire;
    fn wire(self) -> Self::Wire;
}

/// Can be received in a request.
pub trait Request {
    /// What it asks for.
    type Means;
    fn means(self) -> Self::Means;
}

/// Types that are the same inside and outside.
macro_rules! same {
    ($($Same:ty),*) => {
        $(impl Answer for $Same {
            type Wire = Self;
            fn wire(self) -> Self {
                self
            }
        }
        impl Request for $Same {
            type Means = Self;
            fn means(self) -> Self {
                self
            }
        })*
    };
}

same!(bool, u8, u16, u32, u64, i64, usize, f64, String, &'static str, serde_json::Value);

impl<T: Answer> Answer for Option<T> {
    type Wire = Option<T::Wire>;
    fn wire(self) -> Self::Wire {
        self.map(T::wire)
    }
}

impl<T: Answer> Answer for Vec<T> {
    type Wire = Vec<T::Wire>;
    fn wire(self) -> Self::Wire {
        self.into_iter().map(T::wire).collect()
    }
}

impl<T: Answer, const N: usize> Answer for [T; N] {
    type Wire = [T::Wire; N];
    fn wire(self) -> Self::Wire {
        self.map(T::wire)
    }
}

impl<T: Answer> Answer for BTreeMap<String, T> {
    type Wire = BTreeMap<String, T::Wire>;
    fn wire(self) -> Self::Wire {
        self.into_iter().map(|(key, value)| (key, value.wire())).collect()
    }
}

impl<T: Request> Request for Option<T> {
    type Means = Option<T::Means>;
    fn means(self) -> Self::Means {
        self.map(T::means)
    }
}

impl<T: Request> Request for Vec<T> {
    type Means = Vec<T::Means>;
    fn means(self) -> Self::Means {
        self.into_iter().map(T::means).collect()
    }
}

impl<T: Request, const N: usize> Request for [T; N] {
    type Means = [T::Means; N];
    fn means(self) -> Self::Means {
        self.map(T::means)
    }
}

impl<T: Request> Request for BTreeMap<String, T> {
    type Means = BTreeMap<String, T::Means>;
    fn means(self) -> Self::Means {
        self.into_iter().map(|(key, value)| (key, value.means())).collect()
    }
}

/// A page of a list, and the cursor of the next one.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Page<T> {
    /// The items, in the list's order.
    pub items: Vec<T>,
    /// Pass it as `after` to read on; absent on the last page.
    pub next: Option<String>,
}

impl<T: Answer> Answer for app::Page<T> {
    type Wire = Page<T::Wire>;
    fn wire(self) -> Self::Wire {
        let Self { items, next } = self;
        Page { items: items.wire(), next }
    }
}

/// A point in time, milliseconds since 1970-01-01 UTC; RFC 3339 text in JSON.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(value_type = String, format = DateTime, examples("2026-11-21T08:00:00.25Z"))]
pub struct Timestamp(String);

impl Answer for domain::timestamp::Timestamp {
    type Wire = Timestamp;
    fn wire(self) -> Timestamp {
        Timestamp(self.to_string())
    }
}

/// What callers write on weighings and jobs so that their own programs find them: up to 32 values
/// by key, 4 KiB in all. A key is 1 to 63 letters, digits, `-`, `_`, `.` or `/`, a value up to 255
/// characters. `correlation_id` is also set by the header `X-Correlation-Id`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({ "plate": "A7" })))]
pub struct Labels(BTreeMap<String, String>);

impl Answer for domain::labels::Labels {
    type Wire = Labels;
    fn wire(self) -> Labels {
        Labels(self.0)
    }
}

impl Request for Labels {
    type Means = domain::labels::Labels;
    fn means(self) -> domain::labels::Labels {
        domain::labels::Labels(self.0)
    }
}

/// A rejected input field: which field, what was expected, what to do.
///
/// Every layer that rejects an input reports it with this type; the API turns it into problem+json.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FieldError {
    /// Path of the field as the caller wrote it, e.g. `target.value`.
    pub field: String,
    /// The bound and how to fix it, e.g. `must be between 0.1 and 30 mg; ask for less or use a
    /// larger spoon`.
    pub message: String,
}

answer! { domain::FieldError => FieldError { field, message } }

/// Whether a value is the one that is left out.
fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}
