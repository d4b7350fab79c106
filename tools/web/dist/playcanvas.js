/*! cogsplat, Apache-2.0 */
var C=new Uint32Array(1),F=new Float32Array(C.buffer);function g(e){F[0]=e;let s=C[0]>>>16&32768,t=Math.min(Math.abs(e),65504);if(t<2**-14)return s|Math.round(t*2**24);F[0]=t;let n=C[0];return s|n+4095+(n>>>13&1)-939524096>>>13}function w(e){let s=e&32768?-1:1,t=e>>>10&31,n=e&1023;return s*(t===0?n*2**-24:(1024+n)*2**(t-25))}function v(e,s){let t=e*Math.exp(s);return t/(t+1-e)}var U=e=>({name:e,width:4,bytes:2}),m=(e,s=4)=>({name:e,width:s,bytes:4}),A=[U("dcColor"),m("transformA"),U("transformB")],G=[A,[...A,m("splatSH_1to3")],[...A,m("splatSH_1to3"),m("splatSH_4to7"),m("splatSH_8to11",1)],[...A,m("splatSH_1to3"),m("splatSH_4to7"),m("splatSH_8to11"),m("splatSH_12to15")]];var gt=Math.log(65504);function I({arrays:e,count:s},t,n,r){let[i,,a]=e,[o,,f]=n;for(let c=0;c<s;c++){let p=4*(r+c);o[p+3]=g(v(w(i[4*c+3]),t.opacities[c]));let u=Math.exp(t.scales[c]);for(let h=0;h<3;h++)f[p+h]=g(w(a[4*c+h])*u)}}var M=(...e)=>e.map(s=>({name:s,width:4,bytes:4})),z=[M("centers","shapes"),M("centers","shapes","sh1"),M("centers","shapes","sh1","sh2"),M("centers","shapes","sh1","sh2","sh3a","sh3b")];function V({arrays:e,count:s},t,n,r){let[i,a]=e,[o,f]=n;for(let c=0;c<s;c++){let p=4*(r+c),u=h=>g(w(h)+t.scales[c]);o[p+3]=g(v(w(i[4*c+3]),t.opacities[c])),f[p+1]=a[4*c+1]&65535|u(a[4*c+1]>>>16)<<16,f[p+2]=u(a[4*c+2]&65535)|u(a[4*c+2]>>>16)<<16}}var at=new Float32Array(1),bt=new Uint32Array(at.buffer);function T(e,s){return(e==="spark"?z:G)[s]}function W(e,s,t){return ct(T(e,s),t)}function ct(e,s){return e.map(({width:t,bytes:n})=>n===4?new Uint32Array(t*s):new Uint16Array(t*s))}function N(e,s,t,n){let{arrays:r,count:i,layout:a}=e;r.forEach((o,f)=>t[f].set(o,o.length/i*n)),s!==void 0&&(a==="spark"?V:I)(e,s,t,n)}var it={R:"L",L:"R",U:"D",D:"U",F:"B",B:"F"};function P(e,s="RUB"){return[...s].flatMap(t=>[...e].map(n=>n===t?1:n===it[t]?-1:0))}function $(e,s="RUB"){let t=P(e,s);if(t[0]*(t[4]*t[8]-t[5]*t[7])-t[1]*(t[3]*t[8]-t[5]*t[6])+t[2]*(t[3]*t[7]-t[4]*t[6])<0)throw new RangeError(`axes ${e} are a reflection of ${s}`);let r=[1+t[0]-t[4]-t[8],1-t[0]+t[4]-t[8],1-t[0]-t[4]+t[8],1+t[0]+t[4]+t[8]],i=r.indexOf(Math.max(...r)),a=Math.sqrt(r[i]),o=.5/a;switch(i){case 0:return[a/2,(t[1]+t[3])*o,(t[2]+t[6])*o,(t[7]-t[5])*o];case 1:return[(t[1]+t[3])*o,a/2,(t[5]+t[7])*o,(t[2]-t[6])*o];case 2:return[(t[2]+t[6])*o,(t[5]+t[7])*o,a/2,(t[3]-t[1])*o];default:return[(t[7]-t[5])*o,(t[2]-t[6])*o,(t[3]-t[1])*o,a/2]}}function q(e,s){let[t,n,r]=["",!1,!1],i=e.scene.on("gsplat:sorted",()=>r=!0),a=e.on("frameend",()=>{let f=(e.systems.camera?.cameras??[]).map(({entity:{forward:c}})=>`${c.x} ${c.y} ${c.z}`).join();f!==t?[t,n,r]=[f,!0,!1]:n&&r&&(n=!1,s())});return()=>{i.off(),a.off()}}function j(e,s){let t=e;for(let[n,r]of s){if(!t.includes(n))return;t=t.replaceAll(n,r)}return t}function J(e){return Number.isInteger(e)?`${e}.0`:String(e)}var ft=250,lt=6;function L(e,s){return Math.min(s.degree??e.info.shDegree,e.info.shDegree)}async function K(e,s,t,n,r){let i=n.compensate??!0,a=new _(e,t,i),o=new O,f=-1/0,c=e.stream({...n,degree:L(e,n),compensate:i,format:s,signal:r});for await(let p of c)a.put(p.chunk,{texels:p.texels,firstRow:p.firstRow},p.prefix),await o.rest(),!(performance.now()-f<(n.uploadInterval??ft))&&(await a.show(o),n.onUpload?.(a.shown),f=performance.now());await a.show(o),n.onUpload?.(a.shown)}function X(e,s,t){return W(s,t,e.info.splats)}var _=class{scene;target;compensate;shown=0;rows=0;prefix=0;chunks=new Map;fresh=new Set;shownPrefix=-1;constructor(s,t,n){this.scene=s,this.target=t,this.compensate=n}put(s,t,n){this.chunks.set(s,t),this.fresh.add(s),this.rows=Math.max(this.rows,t.firstRow+t.texels.count),this.prefix=n}async show(s){let t=this.prefix,n=this.compensate&&t!==this.shownPrefix?[...this.chunks.keys()]:[...this.fresh];if(n.length!==0){for(let r of n){let{texels:i,firstRow:a}=this.chunks.get(r),o=this.compensate&&r<t?this.scene.compensation.shifts(t,r):void 0;N(i,o,this.target.arrays,a),await s.rest()}this.fresh.clear(),this.shownPrefix=t,this.shown=this.rows,(!this.compensate||t===this.scene.index.totalChunkCount)&&this.chunks.clear(),this.target.upload(this.rows)}}},O=class{since=performance.now();async rest(){performance.now()-this.since<lt||(await new Promise(s=>setTimeout(s,0)),this.since=performance.now())}};function Y(e){let s=new AbortController;return e?.aborted?s.abort(e.reason):e?.addEventListener("abort",()=>s.abort(e.reason),{once:!0}),s}function Q(e,{worldOrigin:s}){let t=e.info.origin.map((r,i)=>r-(s??e.info.origin)[i]),n=P(e.info.axes);return[0,1,2].map(r=>t.reduce((i,a,o)=>i+n[3*r+o]*a,0))}function zt(e,s,{info:t}){let{gsplat:n}=s.scene;n.minPixelSize=0,n.antiAlias=t.antialiased;let r=e.ShaderChunks.get(s.graphicsDevice,"glsl"),i=J(4*t.kernelPx),a={gsplatPS:[["normExp(A) * gaussianColor.a","min(0.99, exp(A * -4.0) * gaussianColor.a)"],["if (A > 1.0)","if (A > 1.4)"]],gsplatCommonVS:[["float clip = min(1.0, sqrt(max(0.0, log(alpha / alphaClipValue))) * 0.5);","float clip = sqrt(max(0.0, log(alpha / alphaClipValue))) * 0.5;"]],gsplatCornerVS:[["+ 0.3",`+ ${i}`],["vec2 J2 = -J1 / vp.z * vp.xy;","vec2 edge = 1.3 / vec2(center.projMat00, abs(center.projMat11)); vec2 J2 = -J1 * clamp(vp.xy / vp.z, -edge, edge);"],["min(1024.0, min(viewport_size.x, viewport_size.y))","1e6"]]},o=Object.entries(a).map(([f,c])=>[f,j(r.get(f)??"",c)]);if(o.some(([,f])=>f===void 0))return!1;for(let[f,c]of o)n.material.getShaderChunks("glsl").set(f,c);return!0}var Z=1024,ut=`
uint cogsRotation;
vec4 cogsScale;
vec3 getCenter() {
  uvec4 transform = loadTransformA();
  cogsRotation = transform.w;
  cogsScale = loadTransformB();
  return uintBitsToFloat(transform.xyz);
}
vec4 getColor() { return loadDcColor(); }
vec3 getScale() { return cogsScale.xyz; }
vec4 getRotation() {
  vec3 s = (vec3((uvec3(cogsRotation) >> uvec3(0u, 10u, 20u)) & 1023u) / 511.5 - 1.0) * 0.70710678;
  float rest = sqrt(max(0.0, 1.0 - dot(s, s)));
  uint largest = cogsRotation >> 30u;
  if (largest == 0u) return vec4(rest, s);
  if (largest == 1u) return vec4(s.x, rest, s.yz);
  return largest == 2u ? vec4(s.xy, rest, s.z) : vec4(s, rest);
}
#include "gsplatUncompressedSHVS"
`,pt=`
var<private> cogsRotation: u32;
var<private> cogsScale: vec4f;
fn getCenter() -> vec3f {
  let transform: vec4<u32> = loadTransformA();
  cogsRotation = transform.w;
  cogsScale = loadTransformB();
  return bitcast<vec3f>(transform.xyz);
}
fn getColor() -> vec4f { return loadDcColor(); }
fn getScale() -> vec3f { return cogsScale.xyz; }
fn getRotation() -> vec4f {
  let s = (vec3f((vec3u(cogsRotation) >> vec3u(0u, 10u, 20u)) & vec3u(1023u)) / 511.5 - 1.0) * 0.70710678;
  let rest = sqrt(max(0.0, 1.0 - dot(s, s)));
  let largest = cogsRotation >> 30u;
  if (largest == 0u) { return vec4f(rest, s); }
  if (largest == 1u) { return vec4f(s.x, rest, s.yz); }
  if (largest == 2u) { return vec4f(s.xy, rest, s.z); }
  return vec4f(s, rest);
}
#include "gsplatUncompressedSHVS"
`;function Vt(e,s,t,n={}){let r=L(e,n),i=T("playcanvas",r),a=X(e,"playcanvas",r),o=i.map(({name:l,width:S,bytes:x})=>({name:l,format:x===2?s.PIXELFORMAT_RGBA16F:S===1?s.PIXELFORMAT_R32U:s.PIXELFORMAT_RGBA32U})),f=new s.GSplatFormat(t,o,{readGLSL:ut,readWGSL:pt}),c=n.leastRows??0,p=Math.max(e.info.splats,c)+Z-1,u=new s.GSplatContainer(t,p,f);u.configureMaterialDefines=l=>l.set("SH_BANDS",String(r)),u.gsplatData.shBands=r;let{box:h}=e.info,[y,k]=[[0,1,2].map(l=>(h[l]+h[l+3])/2),[0,1,2].map(l=>(h[l+3]-h[l])/2)];u.aabb.center.set(y[0],y[1],y[2]),u.aabb.halfExtents.set(k[0],k[1],k[2]);for(let l=0;l<3*p;l++)u.centers[l]=y[l%3];u.update(0);let tt=0,B=(l,S)=>u.update(l+tt++%Z,S),b=0,R=a[1],et=new Float32Array(R.buffer,R.byteOffset,R.length),st=l=>{i.forEach(({name:x},d)=>{let E=u.getTexture(x);E.lock().set(a[d]),E.unlock()});let{centers:S}=u;for(let x=0;x<l;x++)for(let d=0;d<3;d++)S[3*x+d]=et[4*x+d];b=Math.max(l,c),B(b,!0)},{application:H}=n,nt=H&&q(H,()=>{b>0&&B(b,!1)}),D=Y(n.signal),ot=K(e,"playcanvas",{arrays:a,upload:st},n,D.signal);return{resource:u,rotation:$(e.info.axes),position:Q(e,n),done:ot,dispose(){D.abort(),nt?.(),u.destroy()}}}export{zt as drawBySpec,Vt as streamToPlayCanvas};
