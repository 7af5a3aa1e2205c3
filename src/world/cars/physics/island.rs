//! Bodies that joints and contacts tie together, solved as one.

use super::contact::{ContactRow, Side};
use super::joint::{JointImpulse, JointRow};
use super::math::{Rot, Transform};
use super::motion::{Position, Velocity};
use super::{Body, Contact, Joint};
use crate::world::cars::trig::Trig;

/// Iterations of the velocity solver, and at most of the position solver, a step (gym's `world.Step(1/50, 180, 60)`).
const VELOCITY_ITERATIONS: usize = 180;
const POSITION_ITERATIONS: usize = 60;
/// Farthest motion in a step: units and radians.
const MAX_TRANSLATION: f32 = 2.0;
const MAX_ROTATION: f32 = 0.5 * std::f32::consts::PI;
/// A body slower than this, units and radians a second, for so long falls asleep.
const SLEEP_LINEAR: f32 = 0.01;
const SLEEP_ANGULAR: f32 = 2.0 / 180.0 * std::f32::consts::PI;
const SECS_TO_SLEEP: f32 = 0.5;

/// The lists of an island and the memory to solve it in, kept over steps.
#[derive(Clone, Debug, Default)]
pub(super) struct Island {
    pub(super) bodies: Vec<usize>,
    pub(super) contacts: Vec<usize>,
    pub(super) joints: Vec<usize>,
    positions: Vec<Position>,
    rows: Vec<JointRow>,
    state: Iterate,
    seen: Iterate,
}

/// Everything that a velocity iteration changes.
#[derive(Debug, Default)]
struct Iterate {
    velocities: Vec<Velocity>,
    impulses: Vec<JointImpulse>,
    contacts: Vec<ContactRow>,
}

impl Iterate {
    fn same(&self, other: &Self) -> bool {
        self.velocities.iter().zip(&other.velocities).all(|(a, b)| a.same(*b))
            && self.impulses.iter().zip(&other.impulses).all(|(a, b)| a.same(*b))
            && self.contacts.iter().zip(&other.contacts).all(|(a, b)| a.same_impulses(b))
    }
}

impl Clone for Iterate {
    fn clone(&self) -> Self {
        Self {
            velocities: self.velocities.clone(),
            impulses: self.impulses.clone(),
            contacts: self.contacts.clone(),
        }
    }

    fn clone_from(&mut self, other: &Self) {
        self.velocities.clone_from(&other.velocities);
        self.impulses.clone_from(&other.impulses);
        self.contacts.clone_from(&other.contacts);
    }
}

impl Island {
    pub(super) fn clear(&mut self) {
        self.bodies.clear();
        self.contacts.clear();
        self.joints.clear();
    }

    /// Moves the bodies of the island on by `dt` seconds.
    pub(super) fn solve(
        &mut self,
        bodies: &mut [Body],
        joints: &mut [Joint],
        contacts: &mut [Contact],
        fixture_body: impl Fn(usize) -> usize,
        (dt, dt_ratio, trig): (f32, f32, Trig),
    ) {
        self.positions.clear();
        self.state.velocities.clear();
        for (i, &body) in self.bodies.iter().enumerate() {
            let body = &mut bodies[body];
            body.island_idx = i;
            body.center_before = body.center;
            body.angle_before = body.angle;
            self.positions.push(Position { c: body.center, a: body.angle });
            let v = body.v + dt * (body.inv_mass * body.force);
            self.state.velocities.push(Velocity { v, w: body.w });
        }

        self.state.contacts.clear();
        for &contact in &self.contacts {
            let side = |fixture| {
                let body: &Body = &bodies[fixture_body(fixture)];
                let (inv_mass, inv_inertia) = (body.inv_mass, body.inv_inertia);
                Side { idx: body.island_idx, inv_mass, inv_inertia, local_center: body.local_center }
            };
            let Contact { a, b, ref manifold, .. } = contacts[contact];
            let sides = [side(a), side(b)];
            let given = (dt_ratio, trig);
            let row =
                ContactRow::new(contact, manifold, sides, &self.positions, &self.state.velocities, given);
            self.state.contacts.push(row);
        }
        for row in &self.state.contacts {
            row.warm_start(&mut self.state.velocities);
        }

        self.rows.clear();
        self.state.impulses.clear();
        for &idx in &self.joints {
            let joint = &mut joints[idx];
            let (a, b) = (&bodies[joint.a], &bodies[joint.b]);
            let sides = [(a.island_idx, a), (b.island_idx, b)];
            let given = (dt, dt_ratio, trig);
            let row = JointRow::new(idx, joint, sides, &self.positions, &mut self.state.velocities, given);
            self.rows.push(row);
            self.state.impulses.push(joint.impulse);
        }

        self.iterate_velocities();
        for (row, impulse) in self.rows.iter().zip(&self.state.impulses) {
            joints[row.joint()].impulse = *impulse;
        }
        for row in &self.state.contacts {
            row.store(contacts);
        }

        self.integrate(dt);
        let in_place = self.iterate_positions(trig);
        self.write_back(bodies, trig);
        self.fall_asleep(bodies, dt, in_place);
    }

    /// Runs all iterations, or as many as make a difference.
    ///
    /// DIFFERENCE: an iteration depends on nothing but the state that it changes. So once a state comes back, to the
    /// last bit, the rest goes in circles, and only the remainder of the last circle is run (Brent's way of finding a
    /// cycle). The result is that of all 180 iterations, in a fraction of the time.
    fn iterate_velocities(&mut self) {
        let (mut seen_at, mut next_look) = (0, 1);
        let mut done = 0;
        while done < VELOCITY_ITERATIONS {
            self.iterate_once();
            done += 1;
            if seen_at > 0 && self.state.same(&self.seen) {
                let period = done - seen_at;
                for _ in 0..(VELOCITY_ITERATIONS - done) % period {
                    self.iterate_once();
                }
                return;
            }
            if done == next_look {
                self.seen.clone_from(&self.state);
                seen_at = done;
                // The step must grow for long circles to fit. A quarter at a time finds short ones early.
                next_look = done + done / 4 + 1;
            }
        }
    }

    #[inline]
    fn iterate_once(&mut self) {
        let Iterate { velocities, impulses, contacts } = &mut self.state;
        for (row, impulse) in self.rows.iter().zip(impulses) {
            row.solve_velocity(velocities, impulse);
        }
        for row in contacts {
            row.solve_velocity(velocities);
        }
    }

    fn integrate(&mut self, dt: f32) {
        for (position, velocity) in self.positions.iter_mut().zip(&mut self.state.velocities) {
            let shift = dt * velocity.v;
            if shift.dot(shift) > MAX_TRANSLATION * MAX_TRANSLATION {
                velocity.v = (MAX_TRANSLATION / shift.length()) * velocity.v;
            }
            let turn = dt * velocity.w;
            if turn * turn > MAX_ROTATION * MAX_ROTATION {
                velocity.w *= MAX_ROTATION / turn.abs();
            }
            position.c += dt * velocity.v;
            position.a += dt * velocity.w;
        }
    }

    /// Pushes joints and contacts into place. Says whether it succeeded.
    fn iterate_positions(&mut self, trig: Trig) -> bool {
        for _ in 0..POSITION_ITERATIONS {
            let mut deepest = 0.0_f32;
            for row in &self.state.contacts {
                deepest = deepest.min(row.solve_position(&mut self.positions, trig));
            }
            let mut in_place = ContactRow::is_shallow(deepest);
            for row in &self.rows {
                in_place &= row.solve_position(&mut self.positions, trig);
            }
            if in_place {
                return true;
            }
        }
        false
    }

    fn write_back(&self, bodies: &mut [Body], trig: Trig) {
        let solved = self.positions.iter().zip(&self.state.velocities);
        for (&body, (position, velocity)) in self.bodies.iter().zip(solved) {
            let body = &mut bodies[body];
            body.center = position.c;
            body.angle = position.a;
            body.v = velocity.v;
            body.w = velocity.w;
            body.xf = Transform::around(body.center, Rot::new(body.angle, trig), body.local_center);
        }
    }

    fn fall_asleep(&self, bodies: &mut [Body], dt: f32, in_place: bool) {
        let mut least = f32::MAX;
        for &body in &self.bodies {
            let body = &mut bodies[body];
            if body.w * body.w > SLEEP_ANGULAR * SLEEP_ANGULAR
                || body.v.dot(body.v) > SLEEP_LINEAR * SLEEP_LINEAR
            {
                body.sleep_secs = 0.0;
            } else {
                body.sleep_secs += dt;
            }
            least = least.min(body.sleep_secs);
        }
        if least >= SECS_TO_SLEEP && in_place {
            for &body in &self.bodies {
                bodies[body].sleep();
            }
        }
    }
}
