/* Stands in for the Force Dimension SDK's header of this name. Declares only what docs/examples/bridge_forcedimension.cpp calls, so that the example
   compiles without the SDK. Written from the SDK's published function names; does not drive a device. */
#ifndef STANDIN_DHDC_H
#define STANDIN_DHDC_H
extern "C" {
enum { DHD_OFF = 0, DHD_ON = 1 };
int dhdOpen();
int dhdClose(char ID = -1);
int dhdEnableForce(unsigned char val, char ID = -1);
int dhdGetPosition(double *px, double *py, double *pz, char ID = -1);
int dhdGetOrientationFrame(double matrix[3][3], char ID = -1);
int dhdSetForceAndTorque(double fx, double fy, double fz, double tx, double ty, double tz, char ID = -1);
int dhdGetButton(int index, char ID = -1);
const char *dhdErrorGetLastStr();
}
#endif
