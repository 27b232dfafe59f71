#include "kernels/nricp.h"
