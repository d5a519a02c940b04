/* Stands in for CHAI3D's header of this name. Declares only what docs/examples/bridge_chai3d.cpp calls, so that the example compiles without CHAI3D. Written
   from the published class reference; does not drive a device. */
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
