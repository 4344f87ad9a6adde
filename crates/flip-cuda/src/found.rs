//! Cards that are there, without opening them: no memory is taken and nothing is compiled.

use crate::{CardError, Result, layout};
use cudarc::driver::sys::{self, CUdevice_attribute, CUresult};
use cudarc::driver::{DriverError, result};

/// Oldest cards whose instructions the kernels use.
const CAPABILITY: (i32, i32) = (8, 0);
/// Bytes of a block's static shared memory, rounded up.
const STATIC: usize = 1024;

/// A card that can run the kernels.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    /// Its name.
    pub name: String,
    /// Its compute capability.
    pub capability: (i32, i32),
    /// The version of CUDA that its driver has, as in 13000 for 13.0.
    pub driver: i32,
    /// Whether it has the shared memory of the larger kernel.
    pub(crate) is_large: bool,
    /// The same for grains that turn.
    pub(crate) is_larger: bool,
}

impl std::fmt::Display for Found {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (Self { name, driver, .. }, (major, minor)) = (self, self.capability);
        let (cuda, point) = (driver / 1000, driver % 1000 / 10);
        write!(f, "{name}, compute capability {major}.{minor}, CUDA {cuda}.{point}")
    }
}

/// The numbers of all cards of the first usable one's kind, and what they are. Others are left out:
/// what is computed must not depend on where.
///
/// # Errors
/// [`CardError`]: no driver, or no card that can run the kernels, and why the first cannot.
pub fn find_all() -> Result<(Vec<usize>, Found)> {
    let (mut same, mut first_reason) = (None::<(Vec<usize>, Found)>, None);
    for number in 0.. {
        match find(number) {
            Ok(found) => match &mut same {
                None => same = Some((vec![number], found)),
                Some((numbers, kind)) if *kind == found => numbers.push(number),
                Some(_) => {}
            },
            Err(reason) => {
                let of_this_one =
                    matches!(reason, CardError::TooOld { .. } | CardError::TooSmall { .. });
                first_reason.get_or_insert(reason);
                // Else there are no more, or the driver does not work.
                if !of_this_one {
                    break;
                }
            }
        }
    }
    same.ok_or_else(|| first_reason.unwrap_or(CardError::NoDriver))
}

/// The card of this number, counted from 0.
///
/// # Errors
/// [`CardError`]: no driver, no such card, or a card that cannot run the kernels.
pub fn find(number: usize) -> Result<Found> {
    #[allow(unsafe_code)]
    // SAFETY: loading the driver's library runs its initialisers, which have no preconditions.
    if !unsafe { sys::is_culib_present() } {
        return Err(CardError::NoDriver);
    }
    // The bindings panic where the library lacks a function.
    std::panic::catch_unwind(|| found(number)).unwrap_or_else(|_| Err(lacking()))
}

/// The error for a driver that is older than the bindings.
pub(crate) fn lacking() -> CardError {
    CardError::BadDriver("it lacks functions that this program needs".to_owned())
}

fn found(number: usize) -> Result<Found> {
    let bad = |error: DriverError| CardError::BadDriver(format!("{error:?}"));
    let none = |count: usize| CardError::NoCard { number, count };
    match result::init() {
        Err(DriverError(CUresult::CUDA_ERROR_NO_DEVICE)) => return Err(none(0)),
        started => started.map_err(bad)?,
    }
    let count = result::device::get_count().map_err(bad)?.max(0) as usize;
    if number >= count {
        return Err(none(count));
    }
    let card = result::device::get(number as i32).map_err(bad)?;
    let name = result::device::get_name(card)?;
    #[allow(unsafe_code)]
    // SAFETY: the card was returned by the driver.
    let has = |what: CUdevice_attribute| unsafe { result::device::get_attribute(card, what) };
    let major = has(CUdevice_attribute::CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR)?;
    let minor = has(CUdevice_attribute::CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR)?;
    if (major, minor) < CAPABILITY {
        return Err(CardError::TooOld { name, major, minor });
    }
    let bytes = has(CUdevice_attribute::CU_DEVICE_ATTRIBUTE_MAX_SHARED_MEMORY_PER_BLOCK_OPTIN)?;
    let bytes = bytes.max(0) as usize;
    if bytes < layout::SHARED_SMALL + STATIC {
        return Err(CardError::TooSmall { name, bytes });
    }
    let mut driver = 0;
    #[allow(unsafe_code)]
    // SAFETY: the driver writes one number to where the pointer leads.
    unsafe { sys::cuDriverGetVersion(&mut driver) }.result().map_err(bad)?;
    let has_room = |kernel: layout::Kernel| bytes >= kernel.shared() + STATIC;
    let [is_large, is_larger] = [layout::Kernel::Base, layout::Kernel::Extended].map(has_room);
    Ok(Found { name, capability: (major, minor), driver, is_large, is_larger })
}
