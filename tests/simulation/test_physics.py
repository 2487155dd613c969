"""Contacts against closed forms, with the contact settings of the library."""

import numpy as np
import pytest
import trimesh
from pydrake.geometry import Box, Sphere
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ContactModel,
    DiscreteContactApproximation,
)
from pydrake.multibody.tree import PdControllerGains, PrismaticJoint, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from xdex_drake.hand.kinematics import Configuration
from xdex_drake.hand.library import load_hand
from xdex_drake.hand.plant import add_hand
from xdex_drake.scene.bodies import add_object, add_table, contact_material
from xdex_drake.scene.object import load_object
from xdex_drake.scene.plant import PlantSettings

SETTINGS = PlantSettings()
GRAVITY = 9.81


def plant_of_ours():
    """A plant with the library's settings."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=SETTINGS.time_step)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
    plant.set_contact_model(ContactModel.kPoint)
    return builder, plant


@pytest.fixture(scope="module")
def block(tmp_path_factory):
    """A flat box of 100 g."""
    path = tmp_path_factory.mktemp("mesh") / "block.obj"
    trimesh.creation.box((0.06, 0.05, 0.03)).export(path)
    return load_object(path)


@pytest.mark.parametrize("share", [0.97, 0.99, 1.01, 1.03])
def test_a_block_slips_where_the_tangent_of_the_slope_is_mu(block, share):
    """Below it creeps at a steady speed, since friction is regularised; above it gains speed as the formula says."""
    builder, plant = plant_of_ours()
    body = add_object(plant, block)
    add_table(plant, SETTINGS.friction, [body])
    angle = np.arctan(share * SETTINGS.friction)
    # The slope is a table under a tilted gravity.
    plant.mutable_gravity_field().set_gravity_vector(GRAVITY * np.array([np.sin(angle), 0.0, -np.cos(angle)]))
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetFreeBodyPose(context, body, RigidTransform([-0.9, 0.0, 0.015]))
    speeds = []
    for time in (0.5, 2.5):
        simulator.AdvanceTo(time)
        speeds.append(plant.GetVelocities(context)[3])
    acceleration = GRAVITY * (np.sin(angle) - SETTINGS.friction * np.cos(angle))
    if share < 1.0:
        assert 0.0 < speeds[1] < 1e-3
        assert speeds[1] == pytest.approx(speeds[0], rel=1e-3)
    else:
        assert (speeds[1] - speeds[0]) / 2.0 == pytest.approx(acceleration, rel=0.01)


def pinched_drop(block, share):
    """How far a block sinks between two balls in 3 s, pressed by `share` times m g / (2 mu) each after 0.5 s."""
    builder, plant = plant_of_ours()
    body = add_object(plant, block)
    material = contact_material(SETTINGS.friction)
    force = share * block.mass * GRAVITY / (2.0 * SETTINGS.friction)
    plates = []
    instance = plant.AddModelInstance("plates")
    for name, side in (("left", -1.0), ("right", 1.0)):
        plate = plant.AddRigidBody(name, instance, SpatialInertia.SolidBoxWithMass(0.05, 0.01, 0.02, 0.02))
        plant.RegisterCollisionGeometry(plate, RigidTransform(), Sphere(0.005), name, material)
        joint = plant.AddJoint(
            PrismaticJoint(name, plant.world_body().body_frame(), plate.body_frame(), [-side, 0.0, 0.0])
        )
        joint.set_default_translation(-0.035)
        plant.AddJointActuator(name, joint).set_controller_gains(PdControllerGains(p=100.0, d=5.0))
        plates.append(joint)
    plant.set_gravity_enabled(instance, False)
    plant.Finalize()
    # A ball at -35 mm touches the block's wall; beyond it the spring of 100 N/m presses.
    start, end = np.full(2, -0.035), np.full(2, -0.035 + force / 100.0)
    samples = np.column_stack([np.concatenate([q, np.zeros(2)]) for q in (start, end)])
    source = builder.AddSystem(TrajectorySource(PiecewisePolynomial.FirstOrderHold([0.0, 0.5], samples)))
    builder.Connect(source.get_output_port(), plant.get_desired_state_input_port(instance))
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetFreeBodyPose(context, body, RigidTransform())
    # The block hangs in the air until the balls press.
    joint_free = plant.GetJointByName("object")
    joint_free.Lock(context)
    simulator.AdvanceTo(0.6)
    joint_free.Unlock(context)
    simulator.AdvanceTo(3.6)
    return -plant.EvalBodyPoseInWorld(context, body).translation()[2]


def test_a_pinch_holds_above_the_force_that_friction_needs_and_not_below(block):
    assert pinched_drop(block, 1.10) < 1e-3
    assert pinched_drop(block, 0.95) > 0.05


@pytest.mark.parametrize("name", ["ability", "inspire"])
def test_a_coupled_finger_delivers_the_commanded_force(name):
    """By virtual work: the wall's force through the Jacobian with the coupling is the torque of the motor."""
    hand = load_hand(name)
    drive = next(k for k, joint in enumerate(hand.joint_names) if joint.startswith("index"))
    tip = hand.link_index[next(f for f in hand.fingers if f.name == "index").tip_link]
    q = 0.5 * (hand.limits[0] + hand.limits[1])
    k = Configuration.at(hand, RigidTransform(), q)
    of_tip = hand.sphere_links == tip
    centers = k.points(hand.sphere_links, hand.spheres[:, :3])[of_tip]
    radii = hand.spheres[of_tip, 3]
    motion = k.jacobian(np.array([tip]), centers.mean(axis=0, keepdims=True))[0, :, 6 + drive]
    normal = motion / np.linalg.norm(motion)
    face = (centers @ normal + radii).max() + 2e-3

    builder, plant = plant_of_ours()
    gains = (SETTINGS.kp, SETTINGS.kd)
    instance = add_hand(plant, hand, friction=0.0, point_stiffness=SETTINGS.point_stiffness, pd_gains=gains)
    base = plant.GetBodyByName(hand.links[0].name, instance)
    plant.WeldFrames(plant.world_frame(), base.body_frame(), RigidTransform(RotationMatrix(hand.R_HB), hand.p_HB))
    plant.set_gravity_enabled(instance, False)
    p_WB = normal * (face + 5e-3) + (np.eye(3) - np.outer(normal, normal)) @ centers.mean(axis=0)
    X_WB = RigidTransform(RotationMatrix.MakeFromOneVector(normal, 0), p_WB)
    plant.RegisterCollisionGeometry(plant.world_body(), X_WB, Box(0.01, 0.04, 0.04), "wall", contact_material(0.0))
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    for joint, value in zip(hand.joints, hand.q_full(q), strict=True):
        plant.GetJointByName(joint.name, instance).set_angle(context, value)
    target = q.copy()
    target[drive] += 0.3
    plant.get_desired_state_input_port(instance).FixValue(context, np.concatenate([target, np.zeros(len(q))]))
    simulator.AdvanceTo(1.5)
    q_end = np.array([plant.GetJointByName(j, instance).get_angle(context) for j in hand.joint_names])
    commanded = SETTINGS.kp * (target[drive] - q_end[drive])
    end = Configuration.at(hand, RigidTransform(), q_end)
    results = plant.get_contact_results_output_port().Eval(context)
    link_of = {plant.GetBodyByName(link.name, instance).index(): n for n, link in enumerate(hand.links)}
    felt = 0.0
    for c in range(results.num_point_pair_contacts()):
        info = results.point_pair_contact_info(c)
        for body, force in ((info.bodyA_index(), -info.contact_force()), (info.bodyB_index(), info.contact_force())):
            if body in link_of:
                felt -= force @ end.jacobian(np.array([link_of[body]]), info.contact_point()[None])[0, :, 6 + drive]
    assert results.num_point_pair_contacts() > 0 and commanded > 0.05
    assert felt == pytest.approx(commanded, rel=0.05)


@pytest.mark.parametrize("speed", [0.0, 0.5])
def test_energy_does_not_grow(block, speed):
    builder, plant = plant_of_ours()
    body = add_object(plant, block)
    add_table(plant, SETTINGS.friction, [body])
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetFreeBodyPose(context, body, RigidTransform(RollPitchYaw(0.4, 0.3, 0.0), [0.0, 0.0, 0.08]))
    velocities = plant.GetVelocities(context)
    velocities[3:] = [speed, 0.3 * speed, 0.0]
    plant.SetVelocities(context, velocities)
    energies = []
    for k in range(200):
        simulator.AdvanceTo(SETTINGS.time_step * (k + 1))
        energies.append(plant.EvalKineticEnergy(context) + plant.EvalPotentialEnergy(context))
    scale = block.mass * GRAVITY * 0.08
    assert np.diff(energies).max() < 0.01 * scale
    assert energies[-1] < energies[0]
    assert plant.EvalKineticEnergy(context) < 1e-6 * scale
