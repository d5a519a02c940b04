/* Replaces CHAI3D's header of this name. It declares only what docs/examples/bridge_chai3d.cpp calls, so that the example can be
   compiled without CHAI3D. It was written from the published class reference and does not drive a device. */
#ifndef STANDIN_CHAI3D_H
#define STANDIN_CHAI3D_H
#include <memory>
namespace chai3d {
struct cVector3d {
    cVector3d();
    cVector3d(double x, double y, double z);
    double x() const, y() const, z() const;
};
struct cMatrix3d {
    double operator()(int row, int column) const;
};
struct cGenericHapticDevice {
    bool open(), close(), calibrate(bool force = false);
    bool getPosition(cVector3d &position), getRotation(cMatrix3d &rotation), getUserSwitch(int index, bool &pressed);
    bool setForceAndTorqueAndGripperForce(const cVector3d &force, const cVector3d &torque, double gripper);
};
typedef std::shared_ptr<cGenericHapticDevice> cGenericHapticDevicePtr;
struct cHapticDeviceHandler {
    bool getDevice(cGenericHapticDevicePtr &device, unsigned int index = 0);
};
}
#endif
