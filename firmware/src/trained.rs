//! The trained policy in flash, of one of two kinds: for one mission, or for any.
//!
//! An image has a policy of one kind, which its program selects, and only that kind's code and memory.

use core::{fmt::Debug, mem::MaybeUninit};

use firmware_core::{
    SENSORS_MAX, USERS_MAX,
    console::{self, BoardComputer, MissionOrder, OrderError, TEXT_MAX, TrainedPolicy},
    heapless::String,
    policy::{
        mlp::Mlp,
        sets::{NetworkWithWork, SetsNetwork, SetsPolicy, SetsWork},
    },
};

use crate::planner::StaticPlanner;

/// The computer of an image with a policy of kind `K` in flash. Its planner is in memory of its own.
pub type Computer<K> = BoardComputer<<K as FlashPolicy>::Flying, &'static mut StaticPlanner>;

/// The computers' sizes are known.
const _: () = assert!(size_of::<Computer<OneMission>>() <= 11_760);
const _: () = assert!(size_of::<Computer<AnyMission>>() <= 11_760);

/// A kind of policy in flash, and the memory that it needs.
pub trait FlashPolicy: Sized {
    /// The policy in a flight.
    type Flying: TrainedPolicy + Debug + 'static;

    /// Loads the policy from its file, which is checked, and takes the memory.
    ///
    /// # Errors
    /// Returns what is wrong with the file, in words.
    fn load(file: &'static [u8]) -> Result<Self, String<TEXT_MAX>>;

    /// Returns the policy for the flight of an order. Its memory is taken unless the order is refused,
    /// so that another can be flown.
    ///
    /// # Errors
    /// Returns an error if the order is invalid, or if the memory is in use.
    fn for_order(&mut self, order: &MissionOrder) -> Result<Self::Flying, OrderError>;

    /// Returns the memory of the computer; `None` the second time.
    fn computer_memory() -> Option<&'static mut MaybeUninit<Computer<Self>>>;
}

/// A policy for one mission.
#[derive(Debug)]
pub struct OneMission(Mlp<&'static [u8]>);

impl FlashPolicy for OneMission {
    type Flying = Mlp<&'static [u8]>;

    fn load(file: &'static [u8]) -> Result<Self, String<TEXT_MAX>> {
        Mlp::load(file).map(Self).map_err(|error| refused(&error))
    }

    fn for_order(&mut self, _: &MissionOrder) -> Result<Self::Flying, OrderError> {
        Ok(self.0.clone())
    }

    fn computer_memory() -> Option<&'static mut MaybeUninit<Computer<Self>>> {
        cortex_m::singleton!(COMPUTER: MaybeUninit<Computer<OneMission>> = MaybeUninit::uninit())
    }
}

/// A network for any mission, with the memory for evaluating it.
type StaticNetwork = NetworkWithWork<&'static [u8], &'static mut SetsWork>;

/// A policy for any mission, as it flies.
type StaticSetsPolicy = SetsPolicy<f32, StaticNetwork, USERS_MAX, SENSORS_MAX>;

/// A policy for any mission; `None` as soon as it flies.
#[derive(Debug)]
pub struct AnyMission(Option<(StaticNetwork, &'static mut Option<StaticSetsPolicy>)>);

impl FlashPolicy for AnyMission {
    type Flying = &'static mut StaticSetsPolicy;

    fn load(file: &'static [u8]) -> Result<Self, String<TEXT_MAX>> {
        let work = cortex_m::singleton!(SETS_WORK: SetsWork = const { SetsWork::new() });
        let place = cortex_m::singleton!(SETS_POLICY: Option<StaticSetsPolicy> = None);
        let Some((work, place)) = work.zip(place) else {
            return Err(refused(&OrderError::MemoryInUse));
        };
        let network = SetsNetwork::load(file, work).map_err(|error| refused(&error))?;
        Ok(Self(Some((NetworkWithWork { network, work }, place))))
    }

    #[inline(never)]
    fn for_order(&mut self, order: &MissionOrder) -> Result<Self::Flying, OrderError> {
        let mission = order.check()?;
        StaticSetsPolicy::check(&mission)?;
        let (network, place) = self.0.take().ok_or(OrderError::MemoryInUse)?;
        Ok(place.insert(SetsPolicy::new(network, &mission)?))
    }

    fn computer_memory() -> Option<&'static mut MaybeUninit<Computer<Self>>> {
        cortex_m::singleton!(COMPUTER: MaybeUninit<Computer<AnyMission>> = MaybeUninit::uninit())
    }
}

/// Returns what is wrong with the policy, in words.
fn refused(error: &dyn core::fmt::Display) -> String<TEXT_MAX> {
    console::words(&format_args!("policy in flash: {error}"))
}
