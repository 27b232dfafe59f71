#include "kernels/untangle.h"
