/* tools.h - the parts of the command line that are more than parse, call and print. They speak to oceanxl.h alone, and so
 * prove that it suffices; they are not in the library. One section for each file of tools/.
 */
#ifndef TOOLS_H
#define TOOLS_H

#include "../oceanxl.h"

#endif
