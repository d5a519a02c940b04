/* Stands in for OpenHaptics' header of this name. Declares only what docs/examples/bridge_openhaptics.c calls, so that the example compiles without
   OpenHaptics. Written from the published programmer's guide; does not drive a device. */
#ifndef STANDIN_HD_H
#define STANDIN_HD_H
#define HDCALLBACK
typedef unsigned int HHD, HDenum, HDerror, HDCallbackCode;
typedef unsigned long HDSchedulerHandle;
typedef double HDdouble;
typedef int HDint;
typedef struct { HDerror errorCode; int internalErrorCode; HHD hHD; } HDErrorInfo;
enum { HD_FORCE_OUTPUT = 1, HD_CURRENT_TRANSFORM, HD_CURRENT_FORCE, HD_CURRENT_BUTTONS };
enum { HD_DEVICE_BUTTON_1 = 1 };
enum { HD_CALLBACK_DONE, HD_CALLBACK_CONTINUE };
#define HD_DEFAULT_DEVICE ((const char *)0)
#define HD_DEVICE_ERROR(error) ((error).errorCode != 0)
enum { HD_DEFAULT_SCHEDULER_PRIORITY = 0x7fff };
HHD hdInitDevice(const char *name);
void hdDisableDevice(HHD device);
HHD hdGetCurrentDevice(void);
HDErrorInfo hdGetError(void);
void hdEnable(HDenum what), hdBeginFrame(HHD device), hdEndFrame(HHD device);
void hdGetDoublev(HDenum name, HDdouble *values), hdSetDoublev(HDenum name, const HDdouble *values);
void hdGetIntegerv(HDenum name, HDint *values);
void hdStartScheduler(void), hdStopScheduler(void), hdUnschedule(HDSchedulerHandle handle);
HDSchedulerHandle hdScheduleAsynchronous(HDCallbackCode(HDCALLBACK *callback)(void *), void *data, unsigned short priority);
#endif
