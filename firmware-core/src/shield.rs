//! The safety shield: enforces the mission's hard constraints on every action of a policy
//! (`docs/mathematics.md`, section 4).
//!
//! Before slot `n` of `N`, from `q_{n-1}`, the displacement that the policy asks for is projected
//! (Euclidean, exact) onto
//!
//! ```text
//! F_n = { q in Lambda : ||q - q_{n-1}|| <= V delta,  ||q - q_f|| <= (N - n + 1) V delta }
//! ```
//!
//! and the user is the one with the highest score among those that leave enough slots for the
//! quotas of all users: `sum_k max(0, floor(N/M) - count_k) <= N - n` after the slot. So eq:a1 to
//! eq:a3, eq:traj1 and eq:traj2 hold for every policy, trained or broken. A NaN, an infinity or a
//! wrong number of scores counts as no displacement and the admissible user with the best rate, and
//! is reported.
//!
//! `F_n` is the intersection of two discs and a rectangle. The nearest point of such a set is
//! inside, or is the nearest point of one border, or a corner where two borders meet: at most 29
//! candidates, each checked. Worst case: 29 candidates times 6 constraints, no iteration.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::{
    mission::{Area, MEASUREMENT_M, Mission},
    scalar::{Displacement, Position, Scalar},
};

/// What the shield changed in an action, if anything.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Intervention {
    /// The displacement was moved onto `F_n`.
    pub displacement: bool,
    /// The user with the highest score was not admissible.
    pub user: bool,
    /// The output was NaN, infinite or of the wrong size, and was replaced.
    pub broken_output: bool,
    /// `F_n` is empty because the vehicle is not where it was sent: the waypoint is the point
    /// of the speed disc nearest to the destination.
    pub out_of_reach: bool,
}

impl Intervention {
    /// Returns whether anything was changed.
    pub fn any(&self) -> bool {
        self.displacement || self.user || self.broken_output || self.out_of_reach
    }
}

/// A disc on the map.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Disc<T: Scalar> {
    center: Position<T>,
    radius_m: T,
}

/// `F_n`: the set of places where the vehicle may be at the end of the slot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReachableSet<T: Scalar> {
    area: Rectangle<T>,
    /// The places within reach in one slot (eq:traj1).
    step: Disc<T>,
    /// The places from which the destination can be reached in the slots that remain (eq:traj2).
    home: Disc<T>,
    /// [`rounding_m`] of the whole area.
    rounding_m: T,
}

/// An axis-aligned rectangle on the map, its border included.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Rectangle<T: Scalar> {
    south_west: Position<T>,
    north_east: Position<T>,
}

impl<T: Scalar> Rectangle<T> {
    fn contains(&self, place: &Position<T>) -> bool {
        self.clamp(place) == *place
    }

    fn clamp(&self, place: &Position<T>) -> Position<T> {
        Position::new(
            place.x.max(self.south_west.x).min(self.north_east.x),
            place.y.max(self.south_west.y).min(self.north_east.y),
        )
    }
}

/// The capabilities of a vehicle, where they are less than the mission's parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Agility<T> {
    /// The longest step that is asked for, metres: `V_max delta` less a margin, so that no slot is
    /// flown further than `V_max delta`.
    pub step_m: T,
    /// The distance that the vehicle covers in a slot at the speed that it has shown it can hold,
    /// metres.
    pub reach_m: T,
    /// The largest change of velocity in a slot, metres a slot: acceleration times `delta^2`.
    /// Infinite for the paper's kinematics. Called `gain` in the formulas below.
    pub velocity_change_m: T,
    /// The displacement in the last slot, metres east and north. A slot passes before a change of
    /// velocity has an effect.
    pub drift_m: [T; 2],
}

impl<T: Scalar> Agility<T> {
    /// Returns the capabilities of the paper's kinematics: `V_max` in any direction at once.
    pub fn ideal<const M: usize, const J: usize>(mission: &Mission<T, M, J>) -> Self {
        Self {
            step_m: mission.reach_m(),
            reach_m: mission.reach_m(),
            velocity_change_m: T::of(f64::INFINITY),
            drift_m: [T::zero(); 2],
        }
    }

    /// As [`allowed_m`](Self::allowed_m), where the mission ends before the vehicle would be at
    /// rest: after `slots_after` more slots, each of which may reduce the step by `gain`.
    fn ended_m(&self, last_m: T, room_m: T, slots_after: u32) -> T {
        let slots = T::count(slots_after as usize);
        let braked_m =
            self.velocity_change_m * slots * (slots - T::one()).max(T::zero()) / T::of(2.0);
        // The next slot still covers the distance that this one ends with.
        let step_m = (room_m + braked_m) / (slots + T::one());
        let at_rest_before = step_m < self.velocity_change_m * slots;
        // A slot continues the last one's motion before it changes.
        if at_rest_before || last_m > step_m + self.velocity_change_m {
            T::zero()
        } else {
            step_m
        }
    }

    /// Returns the longest step that is asked for on the way to the destination, `way`, with
    /// `slots_left` slots left, this one included. From no such step would the vehicle fly past the
    /// destination and out of the circle of `V_max delta = arrival_m` around it, as far as the
    /// distance to the destination leaves a choice. A step `s` continues for half a slot before
    /// braking has an effect: `3/2 s + s^2 / (2 gain)`.
    fn step_beside(&self, way: Displacement<T>, slots_left: u32, arrival_m: T) -> T {
        let away_m = way.norm();
        let room_m = away_m + arrival_m * T::of(PASSING_FRACTION);
        let stoppable_m = self.largest_m(T::of(1.5), room_m);
        let needed_m =
            (away_m - arrival_m * T::of(ARRIVAL_FRACTION)) / T::count(slots_left as usize);
        // A step to the destination itself is never too long.
        let there_m = if away_m <= arrival_m {
            away_m
        } else {
            T::zero()
        };
        self.step_m.min(stoppable_m.max(needed_m).max(there_m))
    }

    /// Returns the largest step `s` from which the vehicle can still come to rest within `room_m`:
    /// `s + s^2 / (2 gain) = room`.
    fn stoppable_m(&self, room_m: T) -> T {
        self.largest_m(T::one(), room_m)
    }

    /// Returns the positive root of `times s + s^2 / (2 gain) = room`, in a form that also holds
    /// for an infinite gain; returns `room` itself where that is not above zero.
    fn largest_m(&self, times: T, room_m: T) -> T {
        if room_m <= T::zero() {
            return room_m;
        }
        let two = T::of(2.0);
        two * room_m / (times + (times * times + two * room_m / self.velocity_change_m).sqrt())
    }

    /// Returns the largest step of the coming slot in a direction in which all remaining slots
    /// together may cover `room_m`, where the last slot covered `last_m`. The slot covers at least
    /// as much as the last one, and the next covers once more what it ends with; then the vehicle
    /// needs `s^2 / (2 gain)` to come to rest in that direction. Returns `None` where that takes
    /// more than the vehicle can lose in a slot.
    fn allowed_m(&self, last_m: T, room_m: T) -> Option<T> {
        let turning_m = self.stoppable_m(room_m - last_m);
        if turning_m > last_m {
            return Some(self.largest_m(T::of(2.0), room_m));
        }
        (turning_m >= last_m - self.velocity_change_m).then(|| turning_m.max(T::zero()))
    }
}

/// The fraction of `V_max delta` within which a vehicle with inertia is to arrive. If it turns back
/// as late as possible, every inaccuracy of its flight adds to the distance that remains.
const ARRIVAL_FRACTION: f64 = 0.3;
/// The fraction of `V_max delta` past the destination within which a vehicle with inertia must be
/// able to stop.
const PASSING_FRACTION: f64 = 0.5;
/// The fraction of `V_max delta` by which a vehicle with inertia keeps away from the border of the
/// area, for the same reason.
const BORDER_FRACTION: f64 = 0.25;
/// The fraction of the acceleration that is used to brake before a border.
const BORDER_BRAKING_FRACTION: f64 = 0.4;

impl<T: Scalar> ReachableSet<T> {
    /// Creates the set for a step from `from` of at most `step_m` that ends at most `home_m` from
    /// `destination`. Distances are in metres and not negative.
    pub fn new(
        area: Area<T>,
        from: Position<T>,
        step_m: T,
        destination: Position<T>,
        home_m: T,
    ) -> Self {
        Self {
            area: Rectangle {
                south_west: Position::origin(),
                north_east: Position::new(area.east_m, area.north_m),
            },
            step: Disc {
                center: from,
                radius_m: step_m,
            },
            home: Disc {
                center: destination,
                radius_m: home_m,
            },
            rounding_m: rounding_m(&area, step_m),
        }
    }

    /// Returns `F_n` of a mission: slot `n` (1 to `N`) from `from`.
    pub fn of_slot<const M: usize, const J: usize>(
        mission: &Mission<T, M, J>,
        slot: u32,
        from: Position<T>,
    ) -> Self {
        let p = mission.parameters();
        let slots_left = mission.slots().saturating_sub(slot) + 1;
        Self::new(
            p.area,
            from,
            mission.reach_m(),
            p.destination,
            T::count(slots_left as usize) * mission.reach_m(),
        )
    }

    /// Returns `F_n` for a vehicle with inertia: as [`of_slot`](Self::of_slot), but from every
    /// waypoint in the set the vehicle can brake before the border of the area, and turn back to
    /// the destination in time.
    ///
    /// Towards a border, a step `s` must leave the distance that stopping from it takes: `s + s^2 /
    /// (2 gain) <= room`, after a slot that continues the last one's motion. On the way to the
    /// destination the same holds for the difference, as a vector, between the step and full speed
    /// straight to the destination: that difference is lost, and regaining it costs `s^2 / (2
    /// gain)` more, out of the distance that the remaining slots have to spare.
    ///
    /// The disc for the destination is therefore one around the place ahead on the way to the
    /// destination, within that of `F_n`; where it would need more distance than there is to spare
    /// it is that of `F_n`. No constraint is added around the destination where stopping stays
    /// within `V_max delta` of it: there the vehicle has arrived. The two discs intersect wherever
    /// those of `F_n` do. Where braking before a border excludes the intersection, the waypoint is
    /// straight towards the destination.
    pub fn of_slot_with<const M: usize, const J: usize>(
        mission: &Mission<T, M, J>,
        slot: u32,
        from: Position<T>,
        agility: &Agility<T>,
    ) -> Self {
        let mut set = Self::of_slot(mission, slot, from);
        if !agility.velocity_change_m.finite() && agility.reach_m >= mission.reach_m() {
            return set;
        }
        set.step.radius_m = agility.step_beside(
            set.home.center - from,
            mission.slots().saturating_sub(slot) + 1,
            mission.reach_m(),
        );
        let Rectangle {
            south_west,
            north_east,
        } = &mut set.area;
        let slots_after = mission.slots().saturating_sub(slot);
        // A vehicle that turns round also brakes along the border.
        let beside_border = Agility {
            velocity_change_m: agility.velocity_change_m * T::of(BORDER_BRAKING_FRACTION),
            ..*agility
        };
        for axis in 0..2 {
            let (low, high) = (south_west[axis], north_east[axis]);
            let margin_m = agility.reach_m * T::of(BORDER_FRACTION);
            let margin_m = margin_m.min((high - low) / T::of(4.0));
            let (low, high) = (low + margin_m, high - margin_m);
            let here = from[axis];
            // Outside already: back to the border and no further out.
            let inside = here.max(low).min(high);
            let drift_m = agility.drift_m[axis];
            let step_m = |last_m: T, room_m: T| {
                let last_m = last_m.max(T::zero());
                // Too late for normal braking: brake with more than can be relied on.
                let braked_m =
                    (last_m - beside_border.velocity_change_m * T::of(2.0)).max(T::zero());
                let allowed_m = beside_border.allowed_m(last_m, room_m).unwrap_or(braked_m);
                allowed_m.max(beside_border.ended_m(last_m, room_m, slots_after))
            };
            south_west[axis] = (inside - step_m(-drift_m, inside - low)).max(low);
            north_east[axis] = (inside + step_m(drift_m, high - inside)).min(high);
        }
        let home = set.home.center - from;
        let away_m = home.norm();
        let slots_left = T::count((mission.slots().saturating_sub(slot) + 1) as usize);
        let spare_m = (slots_left + T::of(ARRIVAL_FRACTION)) * agility.reach_m - away_m;
        let toward = home / away_m.max(set.rounding_m);
        let [east_m, north_m] = agility.drift_m;
        let last_short_m = (toward * agility.reach_m - Displacement::new(east_m, north_m)).norm();
        let short_m = agility.allowed_m(last_short_m, spare_m);
        let short_m = short_m.unwrap_or(T::zero());
        // From one side of the destination to the other is twice the radius.
        let arrived_m = agility.stoppable_m(mission.reach_m()) / T::of(2.0);
        let ahead_m = set.step.radius_m.min(away_m);
        if away_m - agility.reach_m + short_m <= arrived_m {
            set.home.radius_m = set.home.radius_m.min(arrived_m);
        } else if away_m - ahead_m + short_m <= set.home.radius_m {
            // Inside the disc of `F_n` around the destination.
            set.home = Disc {
                center: from + toward * ahead_m,
                radius_m: short_m,
            };
        }
        // The two discs must intersect, however short the step should be.
        let gap_m = (set.home.center - from).norm() - set.home.radius_m;
        set.step.radius_m = set.step.radius_m.max(gap_m.min(agility.step_m));
        set
    }

    /// Returns whether a place is in the set, up to half of [`rounding_m`].
    pub fn contains(&self, place: &Position<T>) -> bool {
        let slack = self.rounding_m / T::of(2.0);
        let inside = |disc: &Disc<T>| (place - disc.center).norm() <= disc.radius_m + slack;
        self.area.contains(place) && inside(&self.step) && inside(&self.home)
    }

    /// Returns the point of the set that is nearest to `wish`, or `None` if the set is empty.
    pub fn nearest(&self, wish: &Position<T>) -> Option<Position<T>> {
        let mut best: Option<(T, Position<T>)> = None;
        self.each_candidate(wish, |candidate| {
            // Corners are computed; the border of the area is kept exactly.
            let candidate = self.area.clamp(&candidate);
            let distance = (candidate - wish).norm_squared();
            if self.contains(&candidate) && best.is_none_or(|(least, _)| distance < least) {
                best = Some((distance, candidate));
            }
        });
        best.map(|(_, place)| place)
    }

    /// Visits every point that can be nearest to `wish`: itself, its projection on each border, and
    /// the corners where two borders meet.
    fn each_candidate(&self, wish: &Position<T>, mut visit: impl FnMut(Position<T>)) {
        let Rectangle {
            south_west,
            north_east,
        } = self.area;
        let (lines_x, lines_y) = ([south_west.x, north_east.x], [south_west.y, north_east.y]);
        visit(*wish);
        visit(self.area.clamp(wish));
        for disc in [&self.step, &self.home] {
            visit(disc.border_towards(wish));
            // Degenerate sets (a disc of radius 0, discs that touch) have their centres.
            visit(disc.center);
            for x in lines_x {
                disc.meet_line(0, x, &mut visit);
            }
            for y in lines_y {
                disc.meet_line(1, y, &mut visit);
            }
        }
        self.step.meet_disc(&self.home, &mut visit);
        for x in lines_x {
            for y in lines_y {
                visit(Position::new(x, y));
            }
        }
    }
}

impl<T: Scalar> Disc<T> {
    /// Returns the point of the border in the direction of `place`, or the centre if the two
    /// coincide.
    fn border_towards(&self, place: &Position<T>) -> Position<T> {
        let offset = place - self.center;
        let distance = offset.norm();
        if distance <= T::zero() {
            return self.center;
        }
        self.center + offset * (self.radius_m / distance)
    }

    /// Visits the points where the border meets the line on which coordinate `axis` equals `value`.
    fn meet_line(&self, axis: usize, value: T, mut visit: impl FnMut(Position<T>)) {
        let offset = value - self.center[axis];
        let square = self.radius_m * self.radius_m - offset * offset;
        if square < T::zero() {
            return;
        }
        let half_chord = square.sqrt();
        for along in [-half_chord, half_chord] {
            let mut place = self.center;
            place[axis] = value;
            place[1 - axis] += along;
            visit(place);
        }
    }

    /// Visits the points where two borders meet. The nearest points of almost tangent circles count
    /// too, so that discs which touch up to rounding still have a common point.
    fn meet_disc(&self, other: &Self, mut visit: impl FnMut(Position<T>)) {
        // Computed from the smaller disc: from the larger one, rounding of the foot would be
        // magnified by the ratio of the radii.
        let (small, large) = if self.radius_m <= other.radius_m {
            (self, other)
        } else {
            (other, self)
        };
        let axis = large.center - small.center;
        let distance = axis.norm();
        if distance <= T::zero() {
            return;
        }
        let direction = axis / distance;
        // Distance along the axis of the common chord, in the form that does not cancel.
        let along = (distance
            - (large.radius_m - small.radius_m) * ((large.radius_m + small.radius_m) / distance))
            / T::of(2.0);
        let along = along.max(-small.radius_m).min(small.radius_m);
        let half_chord = ((small.radius_m - along) * (small.radius_m + along)).sqrt();
        let foot = small.center + direction * along;
        let normal = Displacement::new(-direction.y, direction.x);
        visit(foot);
        visit(foot + normal * half_chord);
        visit(foot - normal * half_chord);
    }
}

/// Returns the tolerance for rounding of positions, metres: a few units in the last place of the
/// largest length involved, 4 picometres per kilometre in double and 2 mm in single precision. The
/// constraints of a mission hold up to this tolerance, however many slots it has.
pub fn rounding_m<T: Scalar>(area: &Area<T>, reach_m: T) -> T {
    area.east_m.max(area.north_m).max(reach_m) * T::EPSILON * T::of(16.0)
}

/// Returns whether a policy's displacement is finite.
pub fn displacement_is_sound<T: Scalar>(displacement: &Displacement<T>) -> bool {
    displacement.x.finite() && displacement.y.finite()
}

/// Returns the admissible waypoint for a [finite](displacement_is_sound) displacement, and records
/// in `changed` what had to change.
pub fn admissible_waypoint<T: Scalar>(
    set: &ReachableSet<T>,
    displacement: &Displacement<T>,
    changed: &mut Intervention,
) -> Position<T> {
    let from = set.step.center;
    // A very long displacement is shortened first, so that the squares below stay finite.
    let extent = set.area.north_east.x.abs() + set.area.north_east.y.abs();
    let far = (extent + set.step.radius_m) * T::of(4.0);
    let longest = displacement.x.abs().max(displacement.y.abs());
    let wish = if longest > far {
        from + displacement * (far / longest)
    } else {
        from + displacement
    };
    match set.nearest(&wish) {
        Some(waypoint) => {
            // Rounding alone is not an intervention.
            let moved = (waypoint - wish).norm() > set.rounding_m;
            changed.displacement |= moved;
            waypoint
        }
        None => {
            let (home, reach_m) = (&set.home, set.step.radius_m);
            let towards = home.center - from;
            let distance = towards.norm();
            let gap = distance - reach_m - home.radius_m;
            let outside = !set.area.contains(&from);
            // A gap between the discs smaller than the accuracy of a measurement is not reported.
            changed.out_of_reach = gap > set.rounding_m.max(T::of(MEASUREMENT_M)) || outside;
            changed.displacement |= !changed.out_of_reach;
            let waypoint = if gap <= set.rounding_m && !outside {
                // On a mission without any spare distance the discs only touch, and rounding
                // separates them. A waypoint on the border itself prevents the rounding from
                // accumulating.
                home.border_towards(&from)
            } else if distance <= reach_m {
                home.center
            } else {
                from + towards * (reach_m / distance)
            };
            set.area.clamp(&waypoint)
        }
    }
}

/// Tracks which users may be served in a slot so that every quota can still be met (eq:a3).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fairness<const M: usize> {
    counts: Vec<u32, M>,
    quota: u32,
    slots: u32,
    slots_done: u32,
}

impl<const M: usize> Fairness<M> {
    /// Creates the state before the first slot.
    pub fn new<T: Scalar, const J: usize>(mission: &Mission<T, M, J>) -> Self {
        let mut counts = Vec::new();
        // The mission's users fit: they come from a vector of the same capacity.
        let _ = counts.resize(mission.user_count(), 0);
        Self {
            counts,
            quota: mission.quota(),
            slots: mission.slots(),
            slots_done: 0,
        }
    }

    /// Returns the number of slots that each user was served in so far.
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    /// Returns `sum_k max(0, floor(N/M) - count_k)`, the number of slots that are still needed for
    /// the quotas.
    pub fn owed(&self) -> u32 {
        self.counts
            .iter()
            .map(|&count| self.quota.saturating_sub(count))
            .sum()
    }

    /// Returns whether the quotas can still be met if `user` is served in the coming slot.
    pub fn admits(&self, user: usize) -> bool {
        let Some(&count) = self.counts.get(user) else {
            return false;
        };
        let owed_after = self.owed() - u32::from(count < self.quota);
        let slots_after = self.slots.saturating_sub(self.slots_done + 1);
        owed_after <= slots_after
    }

    /// Returns the admissible user with the highest score, the first of equals. Such a user always
    /// exists: quotas are out of reach only after slots in which no user was heard, and then every
    /// user below its quota is admissible.
    pub fn best<T: PartialOrd>(&self, score: impl Fn(usize) -> T) -> Option<usize> {
        let users = 0..self.counts.len();
        let lost = !users.clone().any(|user| self.admits(user));
        let admissible =
            |&user: &usize| self.admits(user) || (lost && self.counts[user] < self.quota);
        let mut best: Option<(usize, T)> = None;
        for user in users.filter(admissible) {
            let value = score(user);
            if best.as_ref().is_none_or(|(_, highest)| value > *highest) {
                best = Some((user, value));
            }
        }
        best.map(|(user, _)| user)
    }

    /// Records the end of a slot in which `user` was served, if any.
    pub fn record(&mut self, user: Option<usize>) {
        self.slots_done += 1;
        if let Some(count) = user.and_then(|user| self.counts.get_mut(user)) {
            *count += 1;
        }
    }

    /// Returns whether every user was served in its `floor(N/M)` slots.
    pub fn is_fair(&self) -> bool {
        self.owed() == 0
    }
}

/// Returns whether a policy's scores are usable: one per user, all finite.
pub fn scores_are_sound<T: Scalar>(scores: &[T], users: usize) -> bool {
    scores.len() == users && scores.iter().all(|score| score.finite())
}

/// Returns the admissible user with the highest score. The scores must be
/// [usable](scores_are_sound).
pub fn admissible_user<T: Scalar, const M: usize>(
    fairness: &Fairness<M>,
    scores: &[T],
    changed: &mut Intervention,
) -> Option<usize> {
    let chosen = fairness.best(|user| scores[user])?;
    changed.user |= scores.iter().any(|&score| score > scores[chosen]);
    Some(chosen)
}
