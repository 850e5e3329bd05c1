"""Nominal machines that swing, slide, roll, hop or fly. All in MJCF, as strings."""

from experiments.second_author.arms import NO_CONTACT, option


def cart_pole() -> str:
    """A pole on a cart with a belt; the pole hangs at 0."""
    return f"""<mujoco model="cart_pole">{option(0.004, "Euler")}{NO_CONTACT}
<worldbody><geom type="capsule" fromto="-1 0 0 1 0 0" size=".01"/>
 <body name="cart" pos="0 0 0"><joint name="rail" type="slide" axis="1 0 0" damping=".6"/>
  <geom type="box" size=".08 .05 .04" mass=".9"/>
  <body name="pole" pos="0 .06 0"><joint name="pivot" axis="0 1 0" damping=".0015"/>
   <geom type="capsule" fromto="0 0 0 0 0 -.5" size=".008" mass=".16"/>
   <geom type="sphere" pos="0 0 -.5" size=".02" mass=".08"/>
  </body></body></worldbody>
<actuator><motor name="belt" joint="rail" ctrlrange="-12 12"/></actuator></mujoco>"""


def gantry() -> str:
    """Overhead crane, two axes, load on a cable (rigid in length)."""
    return f"""<mujoco model="gantry_crane">{option(0.002)}{NO_CONTACT}
<worldbody>
 <body name="bridge" pos="0 0 1.2"><joint name="x" type="slide" axis="1 0 0" damping="8"/>
  <geom type="box" size=".05 .6 .04" mass="5"/>
  <body name="trolley"><joint name="y" type="slide" axis="0 1 0" damping="5"/>
   <geom type="box" size=".07 .07 .04" mass="2"/>
   <body name="knuckle" pos="0 0 -.05"><joint name="sway_x" axis="0 1 0" damping=".001"/>
    <geom type="sphere" size=".012" mass=".03"/>
    <body name="load"><joint name="sway_y" axis="1 0 0" damping=".001"/>
     <geom type="capsule" fromto="0 0 0 0 0 -.55" size=".003" mass=".02"/>
     <geom type="box" pos="0 0 -.62" size=".09 .09 .07" mass=".8"/>
    </body></body></body></body></worldbody>
<actuator>
 <motor name="drive_x" joint="x" ctrlrange="-40 40"/>
 <motor name="drive_y" joint="y" ctrlrange="-25 25"/>
</actuator></mujoco>"""


def furuta() -> str:
    """A pendulum at the end of an arm that a motor turns about the vertical."""
    return f"""<mujoco model="furuta">{option(0.001, "Euler")}{NO_CONTACT}
<worldbody><body name="arm" pos="0 0 .3"><joint name="arm_joint" axis="0 0 1" damping=".0008" armature=".0004"/>
  <geom type="capsule" fromto="0 0 0 .16 0 0" size=".007" mass=".09"/>
  <body name="rod" pos=".17 0 0"><joint name="rod_joint" axis="1 0 0" damping=".0001"/>
   <geom type="capsule" fromto="0 0 0 0 0 -.24" size=".005" mass=".05"/>
   <geom type="sphere" pos="0 0 -.24" size=".012" mass=".03"/>
  </body></body></worldbody>
<actuator><motor name="dc" joint="arm_joint" ctrlrange="-.12 .12"/></actuator></mujoco>"""


def pendulum() -> str:
    """One link on the shaft of a geared motor."""
    return f"""<mujoco model="motor_pendulum">{option(0.002)}{NO_CONTACT}
<worldbody><body name="link" pos="0 0 1"><joint name="shaft" axis="0 1 0" damping=".006" armature=".003"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.28" size=".012" mass=".22"/>
  <geom type="cylinder" pos="0 0 -.28" size=".03 .015" mass=".3"/></body></worldbody>
<actuator><motor name="gearmotor" joint="shaft" ctrlrange="-2.5 2.5"/></actuator></mujoco>"""


def tank_stage() -> str:
    """Linear axis with a lift that carries a container, which an upper motor can tip."""
    return f"""<mujoco model="tank_stage">{option(0.002)}{NO_CONTACT}
<worldbody><body name="sled" pos="0 0 .2"><joint name="x" type="slide" axis="1 0 0" damping="6" armature=".5"/>
  <geom type="box" size=".1 .1 .03" mass="2.2"/>
  <body name="lift" pos="0 0 .1"><joint name="z" type="slide" axis="0 0 1" damping="15" armature=".8"/>
   <geom type="box" size=".08 .08 .02" mass=".9"/>
   <body name="tank" pos="0 0 .1"><joint name="tip" axis="0 1 0" damping=".05" armature=".01"/>
    <geom type="box" size=".06 .06 .08" mass="1.5"/>
   </body></body></body></worldbody>
<actuator>
 <motor name="x_motor" joint="x" ctrlrange="-60 60"/>
 <motor name="z_motor" joint="z" ctrlrange="-90 90"/>
 <motor name="tip_motor" joint="tip" ctrlrange="-4 4"/>
</actuator></mujoco>"""


def rover() -> str:
    """Differential drive with a ball caster, tracked from above."""
    return f"""<mujoco model="rover">{option(0.002)}
<worldbody><geom name="floor" type="plane" size="20 20 .1" friction=".9 .002 .0001"/>
 <body name="chassis" pos="0 0 .05"><freejoint name="root"/>
  <geom name="deck" type="box" size=".12 .09 .025" pos="0 0 .02" mass="2.2" contype="0" conaffinity="0"/>
  <geom name="caster" type="sphere" size=".02" pos=".1 0 -.03" mass=".05" condim="1" priority="1"/>
  <geom name="tail" type="sphere" size=".02" pos="-.1 0 -.03" mass=".05" condim="1" priority="1"/>
  <body name="wheel_l" pos="-.01 .11 0"><joint name="left" axis="0 1 0" damping=".004" armature=".0006"/>
   <geom name="tyre_l" type="ellipsoid" size=".05 .014 .05" mass=".12" friction=".9 .002 .0001"/></body>
  <body name="wheel_r" pos="-.01 -.11 0"><joint name="right" axis="0 1 0" damping=".004" armature=".0006"/>
   <geom name="tyre_r" type="ellipsoid" size=".05 .014 .05" mass=".12" friction=".9 .002 .0001"/></body>
 </body></worldbody>
<actuator>
 <motor name="motor_l" joint="left" ctrlrange="-.8 .8"/>
 <motor name="motor_r" joint="right" ctrlrange="-.8 .8"/>
</actuator></mujoco>"""


def hopper() -> str:
    """Single leg that hops on a vertical rail."""
    return f"""<mujoco model="rail_hopper">{option(0.001)}
<worldbody><geom name="plate" type="plane" size="2 2 .1" friction=".8 .005 .0001"/>
 <body name="carriage" pos="0 0 .36"><joint name="rail" type="slide" axis="0 0 1" damping=".5"/>
  <geom name="block" type="box" size=".05 .04 .04" mass="1.1" contype="0" conaffinity="0"/>
  <body name="thigh"><joint name="hip" axis="0 1 0" damping=".03" armature=".008"/>
   <geom name="thigh_g" type="capsule" fromto="0 0 0 0 0 -.17" size=".02" mass=".35" contype="0" conaffinity="0"/>
   <body name="shank" pos="0 0 -.17"><joint name="knee" axis="0 1 0" damping=".03" armature=".008"/>
    <geom name="shank_g" type="capsule" fromto="0 0 0 0 0 -.16" size=".012" mass=".12" contype="0" conaffinity="0"/>
    <geom name="foot" type="sphere" pos="0 0 -.17" size=".022" mass=".06" friction=".8 .005 .0001"/>
   </body></body></body></worldbody>
<actuator>
 <motor name="hip_drive" joint="hip" ctrlrange="-14 14"/>
 <motor name="knee_drive" joint="knee" ctrlrange="-14 14"/>
</actuator></mujoco>"""


def balancer() -> str:
    """Two-wheeled balancing robot in its plane of motion."""
    return f"""<mujoco model="balancer">{option(0.002)}
<worldbody><geom name="floor" type="plane" size="50 5 .1" friction="1 .005 .0001"/>
 <body name="body" pos="0 0 .05">
  <joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
  <joint name="pitch" axis="0 1 0"/>
  <geom name="box" type="box" size=".03 .07 .09" pos="0 0 .11" mass="1.15" contype="0" conaffinity="0"/>
  <body name="axle"><joint name="wheel" axis="0 1 0" damping=".004" armature=".0006"/>
   <geom name="tyre_l" type="sphere" size=".05" pos="0 .09 0" mass=".09" friction="1 .005 .0001"/>
   <geom name="tyre_r" type="sphere" size=".05" pos="0 -.09 0" mass=".09" friction="1 .005 .0001"/>
  </body></body></worldbody>
<actuator><motor name="wheel_motor" joint="wheel" ctrlrange="-1 1"/></actuator></mujoco>"""


def quadrotor() -> str:
    """Four rotors that push along their sites, free in space."""
    return f"""<mujoco model="quadrotor">{option(0.002)}{NO_CONTACT}
<worldbody><body name="frame" pos="0 0 1"><freejoint name="root"/>
  <inertial pos="0 0 0" mass=".92" diaginertia=".0062 .0066 .0115"/>
  <geom type="box" size=".06 .06 .02" mass="0"/>
  <site name="r1" pos=".12 .12 0"/><site name="r2" pos="-.12 .12 0"/>
  <site name="r3" pos="-.12 -.12 0"/><site name="r4" pos=".12 -.12 0"/>
 </body></worldbody>
<actuator>
 <motor name="rotor1" site="r1" gear="0 0 1 0 0 -.016" ctrlrange="0 6"/>
 <motor name="rotor2" site="r2" gear="0 0 1 0 0 .016" ctrlrange="0 6"/>
 <motor name="rotor3" site="r3" gear="0 0 1 0 0 -.016" ctrlrange="0 6"/>
 <motor name="rotor4" site="r4" gear="0 0 1 0 0 .016" ctrlrange="0 6"/>
</actuator></mujoco>"""
