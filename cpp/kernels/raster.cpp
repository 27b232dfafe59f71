#include "kernels/raster.h"
