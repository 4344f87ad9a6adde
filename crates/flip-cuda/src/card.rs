//! A graphics card, opened with its kernel.

use crate::found::{Found, find, lacking};
use crate::layout::{self, Kernel};
use crate::orders::{Orders, Raw};
use crate::{Result, TooMany};
use cudarc::driver::sys::{CUdevice_attribute, CUevent_flags, CUfunction_attribute};
use cudarc::driver::{
    CudaContext, CudaFunction, CudaModule, CudaSlice, CudaStream, DeviceRepr, DriverError,
    LaunchConfig, PushKernelArg,
};
use cudarc::nvrtc::Ptx;
use flip_sim::dispense::outside::State;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Built by `build_ptx.py` from the sources in `cuda/`.
const KERNELS: &str = include_str!("../ptx/spoons.ptx");
/// The same for grains that turn.
const EXTENDED: &str = include_str!("../ptx/spoons_extended.ptx");
/// The same for heaps.
const HEAPS: &str = include_str!("../ptx/heaps.ptx");
/// Those whose grains turn.
const EXTENDED_HEAPS: &str = include_str!("../ptx/heaps_extended.ptx");
/// Those for spoons without fused multiplication and addition.
const EXACT: &str = include_str!("../ptx/spoons_exact.ptx");
/// Updates of learners; not fused beyond what the source says.
const LEARNERS: &str = include_str!("../ptx/learner.ptx");
/// Threads of a block, and the most for which the kernels are compiled.
const THREADS: u32 = 896;

/// Why a card did not do what was asked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CardError {
    /// There is no driver on this machine.
    #[error("there is no NVIDIA driver on this machine (libcuda is not found); use the CPU")]
    NoDriver,
    /// The driver is there, but too old for this program or not working.
    #[error("the NVIDIA driver cannot be used ({0}); update it or use the CPU")]
    BadDriver(String),
    /// The driver finds no such card.
    #[error(
        "the NVIDIA driver finds {count} graphics cards on this machine, and number {number}, counted from 0, was asked for; use the CPU"
    )]
    NoCard {
        /// What was asked for.
        number: usize,
        /// What there is.
        count: usize,
    },
    /// The card is too old.
    #[error("{name} has compute capability {major}.{minor}, and 8.0 is needed; use the CPU")]
    TooOld {
        /// The card.
        name: String,
        /// Its capability.
        major: i32,
        /// Its capability.
        minor: i32,
    },
    /// The card has too little memory beside its processors.
    #[error(
        "{name} gives a block {bytes} bytes of shared memory, which no kernel fits into; use the CPU"
    )]
    TooSmall {
        /// The card.
        name: String,
        /// What a block may have.
        bytes: usize,
    },
    /// The driver reported an error; the card cannot be used further by this process if a kernel
    /// was running.
    #[error("the card failed: {0}")]
    Failed(String),
    /// The card answered something that cannot be.
    #[error("the card's answer makes no sense: {0}")]
    Nonsense(&'static str),
    /// A spoon or a bed that does not exist was named.
    #[error("number {number} was asked for, and there are {count}, counted from 0")]
    NoSuch {
        /// What was asked for.
        number: usize,
        /// How many there are.
        count: usize,
    },
    /// An empty spoon was named.
    #[error("spoon {0} is empty: fill it first")]
    Empty(usize),
    /// A spoon was given two actions in one step.
    #[error("spoon {0} is named twice in one step; give its actions in two steps")]
    Twice(usize),
    /// A learner or a batch of other sizes than the card was told, or too large for it.
    #[error("{0}")]
    Unfit(&'static str),
    /// A spoonful that a card cannot compute.
    #[error(transparent)]
    TooMany(#[from] TooMany),
}

impl From<DriverError> for CardError {
    fn from(error: DriverError) -> Self {
        Self::Failed(format!("{error:?}"))
    }
}

/// An open card.
#[derive(Debug, Clone)]
pub struct Card {
    stream: Arc<CudaStream>,
    kernel: CudaFunction,
    found: Found,
    multiprocessors: usize,
    /// What `kernel` computes.
    layout: Kernel,
    /// Asked for, or needed for the base simulator.
    is_small: bool,
    threads: u32,
    /// Other kernels that it and its clones have compiled.
    compiled: Arc<Mutex<Vec<Compiled>>>,
}

/// A kernel that was compiled when it was first needed.
#[derive(Debug)]
struct Compiled {
    source: &'static str,
    is_small: bool,
    kernel: CudaFunction,
}

impl Card {
    /// Opens the card of this number, counted from 0, and compiles the kernel for it (a second).
    ///
    /// # Errors
    /// [`CardError`]: no driver, no such card, or a card that cannot run the kernels.
    pub fn open(number: usize) -> Result<Self> {
        Self::with(number, KERNELS, false)
    }

    /// The same card with the kernel whose arithmetic is that of a processor, operation by
    /// operation: slower, and equal to the twin in every bit.
    ///
    /// # Errors
    /// As [`Card::open`].
    pub fn open_exact(number: usize) -> Result<Self> {
        Self::with(number, EXACT, false)
    }

    /// The same card with the kernel for cards with 99 KB of shared memory, whatever this one has.
    ///
    /// # Errors
    /// As [`Card::open`].
    pub fn open_small(number: usize) -> Result<Self> {
        Self::with(number, KERNELS, true)
    }

    fn with(number: usize, kernels: &str, small: bool) -> Result<Self> {
        let found = find(number)?;
        // The bindings panic where the library lacks a function.
        std::panic::catch_unwind(|| Self::opened(number, found, kernels, small))
            .unwrap_or_else(|_| Err(lacking()))
    }

    fn opened(number: usize, found: Found, kernels: &str, small: bool) -> Result<Self> {
        let bad = |error: DriverError| CardError::BadDriver(format!("{error:?}"));
        let context = CudaContext::new(number).map_err(bad)?;
        let is_small = small || !found.is_large;
        let module = context.load_module(Ptx::from_src(kernels)).map_err(bad)?;
        let layout = Kernel::Base;
        let kernel = function(&module, layout, is_small)?;
        let multiprocessors =
            context.attribute(CUdevice_attribute::CU_DEVICE_ATTRIBUTE_MULTIPROCESSOR_COUNT)?;
        let multiprocessors = multiprocessors as usize;
        let stream = context.new_stream()?;
        let (threads, compiled) = (THREADS, Arc::default());
        Ok(Self { stream, kernel, found, multiprocessors, layout, is_small, threads, compiled })
    }

    /// The card's name.
    pub fn name(&self) -> &str {
        &self.found.name
    }

    /// What is known of it.
    pub fn found(&self) -> &Found {
        &self.found
    }

    /// Multiprocessors: spoons that are carried out at the same time.
    pub fn multiprocessors(&self) -> usize {
        self.multiprocessors
    }

    /// The same card with blocks of another number of threads, a multiple of 32 up to 896. Results
    /// do not depend on it.
    #[must_use]
    pub fn with_threads(self, threads: u32) -> Self {
        Self { threads: (threads / 32 * 32).clamp(32, THREADS), ..self }
    }

    /// Memory of the card that nobody has taken, bytes.
    ///
    /// # Errors
    /// A card that fails.
    pub fn free_bytes(&self) -> Result<usize> {
        self.stream.synchronize()?;
        Ok(self.stream.context().mem_get_info()?.0)
    }

    pub(crate) fn stream(&self) -> &Arc<CudaStream> {
        &self.stream
    }

    /// The kernel that updates learners, compiled for this card.
    pub(crate) fn learners(&self) -> Result<CudaFunction> {
        let bad = |error: DriverError| CardError::BadDriver(format!("{error:?}"));
        let module = self.stream.context().load_module(Ptx::from_src(LEARNERS)).map_err(bad)?;
        Ok(module.load_function("flip_learners")?)
    }

    /// The same card with this kernel for heaps, which it computes beside all else.
    pub(crate) fn for_heaps(&self, layout: Kernel) -> Result<Self> {
        let source = match layout {
            Kernel::Base => HEAPS,
            Kernel::Extended => EXTENDED_HEAPS,
        };
        let stream = self.stream.context().new_stream()?;
        Ok(Self { stream, ..self.with_kernel(source, layout)? })
    }

    /// The same card with this kernel for spoons.
    pub(crate) fn for_spoons(&self, layout: Kernel) -> Result<Self> {
        match layout {
            Kernel::Base => Ok(self.clone()),
            Kernel::Extended => self.with_kernel(EXTENDED, layout),
        }
    }

    /// The same card with another kernel, compiled for it once.
    fn with_kernel(&self, source: &'static str, layout: Kernel) -> Result<Self> {
        let is_small = self.is_small || (layout == Kernel::Extended && !self.found.is_larger);
        let mut compiled = self.compiled.lock().unwrap_or_else(PoisonError::into_inner);
        let found = compiled.iter().find(|it| (it.source, it.is_small) == (source, is_small));
        let kernel = match found {
            Some(found) => found.kernel.clone(),
            None => {
                let bad = |error: DriverError| CardError::BadDriver(format!("{error:?}"));
                let module = self.stream.context().load_module(Ptx::from_src(source));
                let kernel = function(&module.map_err(bad)?, layout, is_small)?;
                compiled.push(Compiled { source, is_small, kernel: kernel.clone() });
                kernel
            }
        };
        drop(compiled);
        Ok(Self { kernel, layout, is_small, ..self.clone() })
    }

    /// What it computes.
    pub(crate) fn layout(&self) -> Kernel {
        self.layout
    }

    /// The grains at this place of a table of spoons or heaps.
    pub(crate) fn state(&self, all: &CudaSlice<u32>, place: usize) -> Result<State> {
        let start = place * self.layout.spoon();
        let mut words = self.stream.clone_dtoh(&all.slice(start..start + self.layout.motion()))?;
        self.stream.synchronize()?;
        let memory = layout::present_memory(self.layout, &words);
        let memory = start + memory.start..start + memory.end;
        words.extend(self.stream.clone_dtoh(&all.slice(memory))?);
        self.stream.synchronize()?;
        Ok(layout::state(self.layout, &words))
    }

    /// Carries out the orders on these spoons, or heaps, and waits for the end. `room` is kept for the
    /// next ones.
    pub(crate) fn carry_out(
        &self,
        laws: &CudaSlice<u32>,
        spoons: &mut CudaSlice<u32>,
        orders: &Orders,
        room: &mut Room,
    ) -> Result<Raw> {
        let jobs = orders.jobs.len() / layout::JOB;
        if jobs == 0 {
            return Ok(Raw::default());
        }
        let stream = &self.stream;
        let job_table = stream.clone_htod(&orders.jobs)?;
        // No table may be empty.
        let parts = stream.clone_htod(&padded(&orders.parts, 0))?;
        let bodies = stream.clone_htod(&padded(&orders.bodies, 0.0))?;
        let added = stream.clone_htod(&padded(&orders.added, 0))?;
        let mut rests = stream.alloc_zeros::<u32>((orders.parts.len() / layout::PART).max(1))?;
        let mut lost = stream.alloc_zeros::<u32>(1)?;
        let mut outcomes = stream.alloc_zeros::<u32>(jobs * layout::OUTCOME)?;
        let aside = if self.is_small { jobs * self.layout.room() } else { 16 };
        let (departed, aside) = (
            at_least(&mut room.departed, stream, jobs * layout::GRAINS * self.layout.departed())?,
            at_least(&mut room.aside, stream, aside)?,
        );
        let shared = shared(self.layout, self.is_small);
        let config = LaunchConfig {
            grid_dim: (jobs as u32, 1, 1),
            block_dim: (self.threads, 1, 1),
            shared_mem_bytes: shared as u32,
        };
        stream.synchronize()?;
        let start = Instant::now();
        let mut launch = stream.launch_builder(&self.kernel);
        launch.arg(&job_table).arg(laws).arg(spoons).arg(&parts).arg(&bodies).arg(&added);
        launch.arg(&mut rests).arg(&mut lost).arg(&mut *departed).arg(&mut outcomes);
        launch.arg(aside);
        #[allow(unsafe_code)]
        // SAFETY: the arguments are those of the kernel, in its order; every table has the length
        // that the jobs name, the grains' lists have room for every grain of every job, and the
        // shared memory is what the kernel divides up.
        unsafe {
            launch.launch(config)?;
        }
        wait(stream)?;
        let kernel_s = start.elapsed().as_secs_f64();
        let lost = stream.clone_dtoh(&lost)?;
        stream.synchronize()?;
        let lost = lost.first().map_or(0, |count| *count as usize) * self.layout.departed();
        let raw = Raw {
            outcomes: stream.clone_dtoh(&outcomes)?,
            rests: stream.clone_dtoh(&rests)?,
            departed: match departed.try_slice(..lost) {
                Some(_) if lost == 0 => Vec::new(),
                Some(left) => stream.clone_dtoh(&left)?,
                None => return Err(CardError::Nonsense("more grains left than there were")),
            },
            kernel_s,
        };
        stream.synchronize()?;
        Ok(raw)
    }
}

/// Memory of a card that every launch needs and none leaves anything in: to get it and give it back takes
/// milliseconds for a hundred heaps.
#[derive(Debug, Default)]
pub(crate) struct Room {
    /// The grains that leave.
    departed: Option<CudaSlice<u32>>,
    /// What does not fit into a multiprocessor's own memory.
    aside: Option<CudaSlice<u8>>,
}

/// The memory in its place, or more of it.
fn at_least<'a, T: DeviceRepr>(
    place: &'a mut Option<CudaSlice<T>>,
    stream: &Arc<CudaStream>,
    count: usize,
) -> Result<&'a mut CudaSlice<T>> {
    if let Some(there) = place.take_if(|it| it.len() >= count) {
        return Ok(place.insert(there));
    }
    #[allow(unsafe_code)]
    // SAFETY: the kernel writes what it reads of it, and only what it wrote is copied back.
    let more = unsafe { stream.alloc::<T>(count)? };
    Ok(place.insert(more))
}

/// A module's kernel, with the shared memory that it needs.
fn function(module: &Arc<CudaModule>, layout: Kernel, is_small: bool) -> Result<CudaFunction> {
    let kernel =
        module.load_function(if is_small { "flip_spoons_small" } else { "flip_spoons" })?;
    kernel.set_attribute(
        CUfunction_attribute::CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES,
        shared(layout, is_small) as i32,
    )?;
    Ok(kernel)
}

fn shared(layout: Kernel, is_small: bool) -> usize {
    if is_small { layout::SHARED_SMALL } else { layout.shared() }
}

/// Waits for what the stream has been given, and leaves the core to others meanwhile: a card may take
/// seconds, and other threads learn.
pub(crate) fn wait(stream: &CudaStream) -> Result<()> {
    Ok(stream.record_event(Some(CUevent_flags::CU_EVENT_BLOCKING_SYNC))?.synchronize()?)
}

fn padded<T: Clone>(table: &[T], with: T) -> Vec<T> {
    if table.is_empty() { vec![with] } else { table.to_vec() }
}
