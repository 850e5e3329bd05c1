"""Nominal machines that stand on a base: arms, a wrist, a camera head, a leg on a stand. All in MJCF, as strings."""

NO_CONTACT = '<default><geom contype="0" conaffinity="0"/></default>'


def option(dt: float, integrator: str = "implicitfast") -> str:
    """The element `option`; `dt`: the time step of the model as given [s]."""
    return f'<option timestep="{dt}" integrator="{integrator}" gravity="0 0 -9.81" />'


def desk_arm() -> str:
    """3D-printed desk arm, four hobby-grade position servos."""
    return f"""<mujoco model="desk_arm">{option(0.002)}{NO_CONTACT}
<worldbody><body name="base"><geom type="cylinder" size=".05 .03" mass=".5"/>
 <body name="turret" pos="0 0 .06"><joint name="base_yaw" axis="0 0 1" damping=".05" armature=".006"/>
  <geom type="cylinder" size=".04 .02" mass=".22"/>
  <body name="upper" pos="0 0 .04"><joint name="shoulder" axis="0 1 0" damping=".05" armature=".006"/>
   <geom type="capsule" fromto="0 0 0 0 0 .18" size=".018" mass=".24"/>
   <body name="forearm" pos="0 0 .18"><joint name="elbow" axis="0 1 0" damping=".04" armature=".005"/>
    <geom type="capsule" fromto="0 0 0 .16 0 0" size=".015" mass=".17"/>
    <body name="hand" pos=".16 0 0"><joint name="wrist" axis="0 1 0" damping=".02" armature=".002"/>
     <geom type="box" pos=".04 0 0" size=".035 .025 .012" mass=".11"/>
    </body></body></body></body></body></worldbody>
<actuator>
 <position name="base_servo" joint="base_yaw" kp="14" kv=".55" ctrlrange="-2.5 2.5"/>
 <position name="shoulder_servo" joint="shoulder" kp="22" kv=".9" ctrlrange="-1.6 1.6"/>
 <position name="elbow_servo" joint="elbow" kp="16" kv=".6" ctrlrange="-2 2"/>
 <position name="wrist_servo" joint="wrist" kp="5" kv=".15" ctrlrange="-1.8 1.8"/>
</actuator></mujoco>"""


def scara(armature: tuple[float, ...] = (0.06, 0.03, 0.4, 0.002)) -> str:
    """Four joints, all along the vertical; `armature`: of its joints [kg m^2, of the slide kg]."""
    a = armature
    return f"""<mujoco model="scara">{option(0.002)}{NO_CONTACT}
<worldbody><body name="column"><geom type="cylinder" size=".07 .2" mass="8"/>
 <body name="inner" pos="0 0 .25"><joint name="j1" axis="0 0 1" damping=".25" armature="{a[0]}"/>
  <geom type="box" pos=".13 0 0" size=".16 .045 .03" mass="2.6"/>
  <body name="outer" pos=".28 0 .05"><joint name="j2" axis="0 0 1" damping=".12" armature="{a[1]}"/>
   <geom type="box" pos=".1 0 0" size=".13 .04 .04" mass="1.9"/>
   <body name="quill" pos=".22 0 0"><joint name="z" type="slide" axis="0 0 1" damping="6" armature="{a[2]}"/>
    <geom type="cylinder" size=".012 .12" mass=".7"/>
    <body name="tool" pos="0 0 -.13"><joint name="roll" axis="0 0 1" damping=".004" armature="{a[3]}"/>
     <geom type="box" pos=".02 0 -.02" size=".04 .02 .02" mass=".35"/>
    </body></body></body></body></body></worldbody>
<actuator>
 <motor name="m1" joint="j1" gear="20" ctrlrange="-1 1"/>
 <motor name="m2" joint="j2" gear="12" ctrlrange="-1 1"/>
 <motor name="mz" joint="z" gear="60" ctrlrange="-1 1"/>
 <motor name="mr" joint="roll" gear="1" ctrlrange="-1 1"/>
</actuator></mujoco>"""


def arm6(
    armature: tuple[float, ...] = (0.35, 0.35, 0.2, 0.06, 0.05, 0.03),
    damping: tuple[float, ...] = (1.5, 1.5, 1.0, 0.3, 0.3, 0.2),
) -> str:
    """A heavy arm with torque motors; `armature` [kg m^2] and `damping` [N m s/rad]: of its joints."""
    a, b = armature, damping
    return f"""<mujoco model="arm6">{option(0.002)}{NO_CONTACT}
<worldbody><body name="base"><geom type="cylinder" size=".09 .06" mass="4"/>
 <body name="link1" pos="0 0 .15"><joint name="j1" axis="0 0 1" damping="{b[0]}" armature="{a[0]}"/>
  <geom type="cylinder" size=".065 .07" mass="3.4"/>
  <body name="link2" pos="0 .11 .02"><joint name="j2" axis="0 1 0" damping="{b[1]}" armature="{a[1]}"/>
   <geom type="capsule" fromto="0 0 0 0 0 .38" size=".05" mass="4.6"/>
   <body name="link3" pos="0 -.08 .38"><joint name="j3" axis="0 1 0" damping="{b[2]}" armature="{a[2]}"/>
    <geom type="capsule" fromto="0 0 0 .33 0 0" size=".04" mass="2.3"/>
    <body name="link4" pos=".34 .05 0"><joint name="j4" axis="1 0 0" damping="{b[3]}" armature="{a[3]}"/>
     <geom type="cylinder" size=".035 .05" pos=".04 0 0" quat=".7071 0 .7071 0" mass="1.1"/>
     <body name="link5" pos=".1 0 0"><joint name="j5" axis="0 1 0" damping="{b[4]}" armature="{a[4]}"/>
      <geom type="capsule" fromto="0 0 0 .07 0 0" size=".035" mass=".9"/>
      <body name="flange" pos=".09 0 0"><joint name="j6" axis="1 0 0" damping="{b[5]}" armature="{a[5]}"/>
       <geom type="box" size=".02 .04 .06" pos=".03 0 .02" mass=".5"/>
      </body></body></body></body></body></body></body></worldbody>
<actuator>
 <motor name="t1" joint="j1" ctrlrange="-120 120"/><motor name="t2" joint="j2" ctrlrange="-120 120"/>
 <motor name="t3" joint="j3" ctrlrange="-80 80"/><motor name="t4" joint="j4" ctrlrange="-25 25"/>
 <motor name="t5" joint="j5" ctrlrange="-25 25"/><motor name="t6" joint="j6" ctrlrange="-15 15"/>
</actuator></mujoco>"""


def five_bar() -> str:
    """Planar parallel robot in a vertical plane; loop closed by a connect."""
    return f"""<mujoco model="five_bar">{option(0.001)}{NO_CONTACT}
<worldbody>
 <body name="prox_l" pos="-.06 0 .5"><joint name="drive_l" axis="0 1 0" damping=".02" armature=".012"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.14" size=".01" mass=".16"/>
  <body name="dist_l" pos="0 0 -.14"><joint name="elbow_l" axis="0 1 0" damping=".001"/>
   <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".007" mass=".08"/>
   <geom type="sphere" pos="0 0 -.2" size=".02" mass=".25"/>
   <site name="tip_l" pos="0 0 -.2"/></body></body>
 <body name="prox_r" pos=".06 0 .5"><joint name="drive_r" axis="0 1 0" damping=".02" armature=".012"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.14" size=".01" mass=".16"/>
  <body name="dist_r" pos="0 0 -.14"><joint name="elbow_r" axis="0 1 0" damping=".001"/>
   <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".007" mass=".08"/>
   <site name="tip_r" pos="0 0 -.2"/></body></body>
</worldbody>
<equality><connect site1="tip_l" site2="tip_r" solref=".004 1" solimp=".98 .999 .001"/></equality>
<actuator><motor name="left_motor" joint="drive_l" ctrlrange="-4 4"/>
 <motor name="right_motor" joint="drive_r" ctrlrange="-4 4"/></actuator></mujoco>"""


def gripper() -> str:
    """Wrist with pitch and roll and a parallel gripper whose fingers are geared to each other."""
    return f"""<mujoco model="wrist_gripper">{option(0.002)}{NO_CONTACT}
<worldbody><body name="mount" pos="0 0 .5"><geom type="box" size=".04 .04 .04" mass="2"/>
 <body name="wrist" pos=".05 0 0"><joint name="pitch" axis="0 1 0" damping=".05" armature=".005"/>
  <geom type="box" size=".04 .03 .03" pos=".03 0 0" mass=".4"/>
  <body name="palm" pos=".08 0 0"><joint name="roll" axis="1 0 0" damping=".02" armature=".002"/>
   <geom type="box" size=".03 .06 .025" pos=".03 0 .006" mass=".38"/>
   <body name="finger_l" pos=".08 .03 0"><joint name="slide_l" type="slide" axis="0 1 0" damping="4"/>
    <geom type="box" size=".035 .006 .012" mass=".09"/></body>
   <body name="finger_r" pos=".08 -.03 0"><joint name="slide_r" type="slide" axis="0 -1 0" damping="4"/>
    <geom type="box" size=".035 .006 .012" mass=".09"/></body>
  </body></body></body></worldbody>
<equality><joint joint1="slide_r" joint2="slide_l" polycoef="0 1 0 0 0" solref=".006 1"/></equality>
<actuator>
 <position name="pitch_servo" joint="pitch" kp="14" kv=".5"/>
 <position name="roll_servo" joint="roll" kp="6" kv=".16"/>
 <position name="grip_servo" joint="slide_l" kp="350" kv="10" ctrlrange="-.04 .04"/>
</actuator></mujoco>"""


def pan_tilt() -> str:
    """Camera head, geared motors commanded in torque."""
    return f"""<mujoco model="camera_head">{option(0.002)}{NO_CONTACT}
<worldbody><body name="foot"><geom type="cylinder" size=".06 .02" mass="1"/>
 <body name="yoke" pos="0 0 .06"><joint name="pan" axis="0 0 1" damping=".03" armature=".006"/>
  <geom type="box" size=".06 .02 .06" pos="0 .08 .05" mass=".35"/>
  <geom type="box" size=".06 .08 .01" mass=".3"/>
  <body name="camera" pos="0 0 .1"><joint name="tilt" axis="0 1 0" damping="0" armature=".004"/>
   <geom type="box" pos="-.03 0 .008" size=".07 .04 .04" mass=".75"/>
   <geom type="cylinder" pos=".11 0 .012" quat=".7071 0 .7071 0" size=".03 .04" mass=".25"/>
  </body></body></body></worldbody>
<actuator>
 <motor name="pan_motor" joint="pan" ctrlrange="-2 2"/>
 <motor name="tilt_motor" joint="tilt" ctrlrange="-2 2"/>
</actuator></mujoco>"""


def leg() -> str:
    """One leg of a small quadruped on a test stand, off the ground."""
    return f"""<mujoco model="leg_stand">{option(0.001)}{NO_CONTACT}
<worldbody><body name="stand" pos="0 0 .7"><geom type="box" size=".05 .1 .05" mass="5"/>
 <body name="hip_link" pos=".06 0 0"><joint name="abad" axis="1 0 0" damping=".04" armature=".009"/>
  <geom type="cylinder" size=".045 .025" pos="0 .03 0" mass=".55"/>
  <body name="thigh" pos="0 .07 0"><joint name="hip" axis="0 1 0" damping=".04" armature=".009"/>
   <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".025" mass=".62"/>
   <body name="shank" pos="0 0 -.2"><joint name="knee" axis="0 1 0" damping="0" armature=".012"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.19" size=".012" mass=".13"/>
    <geom type="sphere" pos="0 0 -.2" size=".02" mass=".06"/>
   </body></body></body></body></worldbody>
<actuator>
 <motor name="abad_m" joint="abad" ctrlrange="-17 17"/>
 <motor name="hip_m" joint="hip" ctrlrange="-17 17"/>
 <motor name="knee_m" joint="knee" ctrlrange="-17 17"/>
</actuator></mujoco>"""
